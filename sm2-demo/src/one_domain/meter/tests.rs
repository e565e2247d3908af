use std::process::{self, Command};

use super::*;

/// The kernel's largest process number is 2^22.
const GONE: u32 = u32::MAX / 2;

#[test]
fn processor_time_is_a_part_of_the_time_that_has_passed() {
    let ms = Duration::from_millis;
    assert_eq!(percent(ms(500), ms(1_000)), 50.0);
    assert_eq!(percent(ms(4_000), ms(2_000)), 200.0);
    assert_eq!(percent(ms(0), ms(1_000)), 0.0);
    assert_eq!(percent(ms(500), ms(0)), 0.0);
}

#[test]
fn a_process_that_is_gone_keeps_its_last_time() {
    let last = Duration::from_secs(7);
    assert_eq!(cpu_time(GONE, Some(last)), last);
    assert_eq!(cpu_time(GONE, None), Duration::ZERO);
    let mut meter = Meter::start(vec![GONE, GONE]);
    assert_eq!(meter.measure(), [Cost::default(); 2]);
    let total = meter.total();
    assert_eq!((total.cpu_percent, total.pss_bytes), (0.0, None));
}

/// Counts in processes of their own what this one has used.
#[test]
fn the_total_is_from_the_start_to_the_last_measurement() {
    let pid = process::id();
    let mut meter = Meter::start(vec![pid, GONE]);
    let used = || process_cost::cpu_time(pid).unwrap();
    let at_first = used();
    sm2_test_support::until("50 ms of processor time", || {
        used() >= at_first + Duration::from_millis(50)
    });
    let costs = meter.measure();
    assert!(costs[0].cpu_percent > 0.0, "{costs:?}");
    assert_eq!(costs[1], Cost::default());
    let total = meter.total();
    // The times of the first measurement and of the total are the same.
    assert_eq!(total.cpu_percent, costs[0].cpu_percent);
    assert_eq!(total.pss_bytes, costs[0].pss_bytes);
    assert!(total.wall >= Duration::from_millis(1) && meter.elapsed() >= total.wall);
    // A second measurement begins at the first one, and the most memory is kept.
    let second = meter.measure();
    let most = second[0].pss_bytes.max(total.pss_bytes);
    assert_eq!(meter.total().pss_bytes, most);
    assert!(meter.total().wall > total.wall);
}

/// The kernel counts processor time in ticks of 10 ms.
#[test]
fn the_processor_time_of_a_process_is_that_of_the_system() {
    let ticks = Command::new("cat")
        .arg(format!("/proc/{}/stat", process::id()))
        .output()
        .unwrap();
    let ticks = String::from_utf8(ticks.stdout).unwrap();
    let after_name = ticks.rsplit_once(')').unwrap().1;
    let mut fields = after_name.split_whitespace().skip(11);
    let [user, system] = [(); 2].map(|()| fields.next().unwrap().parse::<u64>().unwrap());
    let at_least = Duration::from_millis((user + system) * 1_000 / procfs::ticks_per_second());
    let now = process_cost::cpu_time(process::id()).unwrap();
    assert!(now >= at_least, "{now:?} {at_least:?}");
    // Not even all processors together can have used more since.
    assert!(
        now < at_least + sm2_test_support::SOON * 100,
        "{now:?} {at_least:?}"
    );
}
