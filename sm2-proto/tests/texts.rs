//! The texts of values, in errors and in the output of programs.

use sm2_proto::control::Limits;
use sm2_proto::{
    Code, Farewell, LinkId, Name, Quota, Refusal, link::wire::Frame, manager::Manager,
};

#[test]
fn a_value_that_is_no_name_is_said_to_be_none() {
    let error = serde_json::from_str::<Name>("7").expect_err("a number");
    assert!(error.to_string().contains("expected a name"), "{error}");
}

#[test]
fn a_link_is_called_by_its_epoch_and_number() {
    let link = LinkId {
        epoch: 0xab,
        serial: 12,
    };
    assert_eq!(link.to_string(), "link ab.12");
}

#[test]
fn a_frame_head_shows_its_bytes() {
    let shown = format!("{:?}", Frame::Close(Code(0x0102)).head());
    assert_eq!(shown, "Head([9, 0, 2, 1, 0, 0, 0, 0])");
}

#[test]
fn a_manager_does_not_show_its_secret() {
    let shown = format!("{:?}", Manager::new(1, 0x0123_4567_89ab, Limits::default()));
    assert!(shown.contains("Secret"), "{shown}");
    for secret in ["1250999896491", "123456789ab"] {
        assert!(!shown.contains(secret), "{shown}");
    }
}

#[test]
fn a_farewell_is_called_as_in_the_specification() {
    assert_eq!(Farewell::PeerGone.to_string(), "peer-gone");
    assert_eq!(Farewell::ShuttingDown.to_string(), "shutting-down");
}

#[test]
fn a_refusal_by_a_quota_names_the_limit_that_sets_it() {
    for quota in Quota::ALL {
        let text = Refusal::Quota { quota, limit: 7 }.to_string();
        let start = format!("the quota of 7 {quota} is used up: close some");
        assert!(text.starts_with(&start), "{text}");
        let told = format!("raise {} of the Manager", quota.limit().name());
        assert!(text.ends_with(&told), "{text}");
    }
}
