//! The paper's Fig. 2: a camera, a local subscriber, and a remote one behind a link that cannot
//! carry every image.

use std::{
    thread,
    time::{Duration, Instant},
};

use sm2_lossy_link::Profile;

use sm2_test_support::until;

use super::world::{self, World};
use crate::traffic::{Listener, Seen, Sent, Talker, assert_complete, assert_newer, percentile};

const IMAGE_BYTES: usize = 1_000_000;
const IMAGE_HZ: u32 = 30;
/// How long the link stays cut.
const CUT: Duration = Duration::from_secs(10);
const PHASE: Duration = Duration::from_secs(5);

/// The name and the start of each phase of the test. The last entry is the end of the test.
struct Phases(Vec<(&'static str, Instant)>);

impl Phases {
    fn begin(&mut self, name: &'static str) {
        self.0.push((name, Instant::now()));
    }

    /// Prints a table with one line per phase.
    fn say(&self, sent: &[Sent], local: &[Seen], remote: &[Seen]) {
        let mut table =
            "phase     s  local Hz  p99 us  publish p99 us  max us  remote Hz  age p50 ms"
                .to_owned();
        for pair in self.0.windows(2) {
            let [(name, from), (_, to)] = pair else {
                continue;
            };
            let seconds = (*to - *from).as_secs_f64();
            let within = |at: Instant| (*from..*to).contains(&at);
            let near: Vec<_> = local.iter().filter(|it| within(it.at)).collect();
            let away: Vec<_> = remote.iter().filter(|it| within(it.at)).collect();
            let took = sent.iter().filter(|it| within(it.at)).map(|it| it.took);
            table += &format!(
                "\n{name:7} {seconds:3.0} {:9.1} {:7} {:15} {:7} {:10.2} {:11}",
                near.len() as f64 / seconds,
                percentile(99, near.iter().map(|it| it.age)).as_micros(),
                percentile(99, took.clone()).as_micros(),
                took.max().unwrap_or_default().as_micros(),
                away.len() as f64 / seconds,
                percentile(50, away.iter().map(|it| it.age)).as_millis(),
            );
        }
        world::say(&table);
    }
}

#[test]
fn a_camera_beside_its_subscriber_does_not_feel_the_link() {
    let _alone = world::alone();
    let Some(link) = world::link(Profile::wifi()) else {
        return;
    };
    let world = World::new(link);
    let [camera, viewer, away] = [
        (&world.near, "camera"),
        (&world.near, "viewer"),
        (&world.far, "away"),
    ]
    .map(|(domain, name)| domain.node(name));
    let mut phases = Phases(Vec::new());
    let talker = Talker::start(&camera, "camera", IMAGE_BYTES, IMAGE_HZ);
    let local = Listener::all(&viewer, "camera", &talker);
    until("a first image", || local.count() > 0);
    phases.begin("before");
    thread::sleep(PHASE);
    phases.begin("joined");
    let remote = Listener::newest(&away, "camera", &talker);
    thread::sleep(PHASE);
    until("images behind the link", || remote.count() > 0);
    phases.begin("30 %");
    world.link.set_loss(30.0).unwrap();
    let before = remote.count();
    thread::sleep(PHASE);
    until("images at 30 % loss", || remote.count() > before + 1);
    phases.begin("cut");
    let ended = remote.ended();
    world.link.cut().unwrap();
    world.link.set_loss(4.0).unwrap();
    thread::sleep(CUT);
    until("the link is lost", || remote.links() == 0);
    assert_eq!(remote.ended(), ended + 1);
    phases.begin("after");
    world.link.restore().unwrap();
    let before = remote.count();
    until("images after the cut", || remote.count() > before + 1);
    until("one link", || remote.links() == 1);
    thread::sleep(PHASE);
    phases.begin("end");
    let sent = talker.sent.clone();
    let count = talker.stop();
    let (local, remote) = (local.stop(), remote.stop());
    phases.say(&sent.lock().unwrap(), &local, &remote);
    // The subscriber was linked from the first image that it saw.
    let first = local[0].number.expect("not damaged");
    assert_complete("the viewer", &local, count - first);
    assert_newer("away", &remote);
    assert!(camera.is_connected() && viewer.is_connected() && away.is_connected());
    world.stop();
}

#[test]
fn a_short_message_goes_beside_a_camera() {
    let _alone = world::alone();
    let Some(link) = world::link(Profile::wifi()) else {
        return;
    };
    let world = World::new(link);
    let (robot, away) = (world.near.node("robot"), world.far.node("away"));
    let camera = Talker::start(&robot, "camera", IMAGE_BYTES, IMAGE_HZ);
    let images = Listener::newest(&away, "camera", &camera);
    until("images behind the link", || images.count() > 0);
    let pose = Talker::start(&robot, "pose", 200, 10);
    let poses = Listener::newest(&away, "pose", &pose);
    until("a first pose", || poses.count() > 0);
    let begin = images.count();
    thread::sleep(PHASE);
    until("an image and ten poses", || {
        images.count() > begin && poses.count() > 10
    });
    camera.stop();
    let count = pose.stop();
    let (images, poses) = (images.stop(), poses.stop());
    let count = count - poses[0].number.expect("not damaged");
    let ages = || poses.iter().map(|it| it.age);
    world::say(&format!(
        "beside {} images, {} of {count} poses came; age p50 {} ms, p99 {} ms",
        images.len() - begin,
        poses.len(),
        percentile(50, ages()).as_millis(),
        percentile(99, ages()).as_millis()
    ));
    assert_newer("images", &images);
    assert_newer("poses", &poses);
    world.stop();
}
