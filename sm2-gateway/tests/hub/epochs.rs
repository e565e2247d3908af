//! Epochs of origins: a process whose clock was set back, and a peer that invents an epoch.

use sm2_proto::gateway::Hop;

use super::{between, gone, hop, message, offered_by, publications, tell, topic, wanted};

/// The clock of an origin was set back, or a peer has invented an epoch of it.
//= SM2-GWC-005 test
#[test]
fn a_smaller_epoch_is_taken_once_the_greater_one_is_gone() {
    let mut hub = between();
    let path = |epoch| {
        let origin = Hop { epoch, ..hop(8) };
        vec![origin, hop(9)]
    };
    for (offer, epoch) in [(5, u64::MAX), (6, 3)] {
        offered_by(&mut hub, 1, offer, topic("map"), path(epoch));
        tell(&mut hub, 2, wanted(offer - 3, 1));
        let mut taken = |sequence| publications(&tell(&mut hub, 1, message(offer, sequence)));
        assert_eq!([7, 7, 8].map(&mut taken), [1, 0, 1], "epoch {epoch}");
        tell(&mut hub, 1, gone(offer));
    }
}
