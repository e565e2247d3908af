//! Configurations: which are refused and at which line, and which changes a reload refuses.

use std::{num::NonZero, path::Path, time::Duration};

use sm2_gateway::{
    Address, Config, ConfigError, DomainLocation, hub::DEFAULT_SEND_QOS, peer::Limits,
};
use sm2_proto::gateway::schedule::SendQos;

const GOOD: &str = "name = \"near\"\nkey = \"key\"\n";

fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::parse(Path::new("dir/gateway.toml"), text)
}

fn with_addresses(addresses: &str) -> String {
    let id = "01".repeat(32);
    format!("{GOOD}[[peer]]\nname = \"far\"\nid = \"{id}\"\naddresses = [\n{addresses}]\n")
}

#[test]
fn a_peer_has_addresses_and_names_of_hosts() {
    let text = with_addresses("\"192.0.2.1:7633\", \"robot.local:7633\"");
    let addresses = &parse(&text).unwrap().peers[0].addresses;
    let host = Address::Host("robot.local:7633".to_owned());
    let expected = [Address::At("192.0.2.1:7633".parse().unwrap()), host];
    assert_eq!(addresses[..], expected);
    for wrong in [
        "robot.local",
        "192.0.2.300:7633",
        "robot..local:1",
        "robot:0",
        "",
    ] {
        let text = with_addresses(&format!("\"robot.local:7633\",\n\"{wrong}\""));
        let error = parse(&text).unwrap_err().to_string();
        let start = format!("dir/gateway.toml:8: `{wrong}` is neither an address with a port");
        assert!(error.starts_with(&start), "{error}");
    }
}

#[test]
fn a_domain_has_a_name_or_a_socket_not_both() {
    let location = |keys: &str| parse(&format!("{keys}{GOOD}")).map(|it| it.domain);
    assert_eq!(location("").unwrap(), DomainLocation::Environment);
    let name = DomainLocation::Name("left".to_owned());
    assert_eq!(location("domain = \"left\"\n").unwrap(), name);
    let socket = DomainLocation::Socket("dir/manager".into());
    assert_eq!(location("socket = \"manager\"\n").unwrap(), socket);
    let error = location("domain = \"left\"\nsocket = \"manager\"\n");
    let text = error.unwrap_err().to_string();
    assert!(text.starts_with("dir/gateway.toml:2: "), "{text}");
}

#[test]
fn each_key_that_only_a_restart_can_take_is_named() {
    let old = parse(GOOD).unwrap();
    assert_eq!(old.fixed_keys(&old), Vec::<&str>::new());
    let table = [
        ("name", GOOD.replace("near", "far")),
        ("listen", format!("listen = \"127.0.0.1:1\"\n{GOOD}")),
        ("key", GOOD.replace("\"key\"", "\"other\"")),
        ("domain", format!("domain = \"other\"\n{GOOD}")),
        ("socket", format!("socket = \"other\"\n{GOOD}")),
        ("discovery", format!("discovery = [\"lo\"]\n{GOOD}")),
        ("congestion", format!("congestion = \"bbr\"\n{GOOD}")),
        ("limits", format!("{GOOD}[limits]\nmessage_bytes = 1\n")),
        ("limits", format!("{GOOD}[limits]\nmemory_bytes = 1\n")),
    ];
    for (key, text) in table {
        assert_eq!(old.fixed_keys(&parse(&text).unwrap()), [key], "{text}");
    }
    // A reload accepts these changes.
    let rule = "[[rule]]\naction = \"allow\"\nnames = \"**\"\n";
    let other = with_addresses("\"robot:1\"") + rule;
    assert_eq!(old.fixed_keys(&parse(&other).unwrap()), Vec::<&str>::new());
}

#[test]
fn a_rule_has_the_parameters_of_its_keys() {
    let rule = "[[rule]]\naction = \"allow\"\nnames = \"**\"\n";
    let send_qos = |keys: &str| {
        let config = parse(&format!("{GOOD}{rule}{keys}"));
        config.map(|it| it.policy.send_qos)
    };
    assert_eq!(send_qos("").unwrap(), [DEFAULT_SEND_QOS]);
    let keys = "priority = 7\nmessages_per_s = 10\nbytes_per_s = 20\nmax_age_ms = 30\n";
    let expected = SendQos {
        depth: DEFAULT_SEND_QOS.depth,
        priority: 7,
        messages_per_s: NonZero::new(10),
        bytes_per_s: NonZero::new(20),
        max_age: Some(Duration::from_millis(30)),
    };
    assert_eq!(send_qos(keys).unwrap(), [expected]);
    let error = send_qos("priority = 8\n").unwrap_err().to_string();
    assert!(error.contains("a priority is 0 to 7"), "{error}");
}

#[test]
fn limits_are_within_their_ranges_and_within_each_other() {
    let limits = |keys: &str| parse(&format!("{GOOD}[limits]\n{keys}")).map(|it| it.limits);
    let default = Limits::default();
    assert_eq!(limits("").unwrap(), default);
    for (keys, [message_bytes, memory_bytes, gateway_bytes]) in [
        (
            "message_bytes = 7",
            [7, default.memory_bytes, default.gateway_bytes],
        ),
        ("memory_bytes = 7", [7, 7, default.gateway_bytes]),
        ("gateway_bytes = 7", [7, 7, 7]),
        (
            "message_bytes = 7\nmemory_bytes = 8\ngateway_bytes = 9",
            [7, 8, 9],
        ),
    ] {
        let expected = Limits {
            message_bytes,
            memory_bytes,
            gateway_bytes,
        };
        assert_eq!(limits(keys).unwrap(), expected, "{keys}");
    }
    for (keys, told) in [
        (
            "message_bytes = 0",
            "`message_bytes` is 0: give 1 to 1099511627776",
        ),
        (
            "message_bytes = 1099511627777",
            "`message_bytes` is 1099511627777: give 1 to 1099511627776",
        ),
        (
            "gateway_bytes = 0",
            "`gateway_bytes` is 0: give 1 to 9223372036854775807",
        ),
        (
            "message_bytes = 9\nmemory_bytes = 8",
            "`message_bytes` is 9: give at most 8, the value of `memory_bytes`, or raise that one",
        ),
        (
            "gateway_bytes = 8\nmemory_bytes = 9",
            "`memory_bytes` is 9: give at most 8, the value of `gateway_bytes`, or raise that one",
        ),
    ] {
        let text = limits(keys).unwrap_err().to_string();
        assert!(text.ends_with(told), "{text}");
    }
}

/// The files of the book are loaded as they stand there.
#[test]
fn each_configuration_of_the_book_is_loaded() {
    let book = include_str!("../../docs/src/gateways.md");
    let blocks = book.split("```toml\n").skip(1);
    let blocks: Vec<&str> = blocks.filter_map(|it| it.split("```").next()).collect();
    assert_eq!(blocks.len(), 2, "{blocks:?}");
    for text in blocks {
        let config = parse(text).unwrap_or_else(|error| panic!("{error} in\n{text}"));
        assert_eq!(config.peers.len(), 1, "{text}");
        let misspelt = text.replacen("names", "name", 1);
        assert!(parse(&misspelt).is_err(), "{misspelt}");
    }
}
