//! The tables of `docs/src/limits.md`, generated from the code.
//!
//! `SM2_WRITE_REFERENCE=1 cargo test -p sm2-cli --lib reference` writes them.

use std::{env, fmt::Write as _, fs, path::Path};

use sm2_gateway::peer;
use sm2_node::{MAX_MAPPED_BYTES, POOL_LIMIT_BYTES, POOL_LIMIT_MESSAGES};
use sm2_proto::{
    control::{Limit, Limits, Unit},
    link::MaxLen,
};

/// The line before a generated table; the name of the table follows.
const BEGIN: &str = "<!-- generated: ";
/// The line after a generated table.
const END: &str = "<!-- end -->";

#[test]
fn the_book_has_the_limits_of_the_code() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/src/limits.md");
    let found = fs::read_to_string(&path).unwrap();
    let tables = [
        ("manager", manager()),
        ("gateway", gateway()),
        ("node", node()),
    ];
    let expected = tables.iter().fold(found.clone(), |page, (name, table)| {
        let begin = format!("{BEGIN}{name} -->\n");
        let (before, rest) = page.split_once(&begin).expect("the begin of the table");
        let (_, after) = rest.split_once(END).expect("the end of the table");
        format!("{before}{begin}\n{table}\n{END}{after}")
    });
    if env::var_os("SM2_WRITE_REFERENCE").is_some() {
        fs::write(&path, &expected).unwrap();
        return;
    }
    assert!(
        found == expected,
        "docs/src/limits.md is out of date: write it again with \
         SM2_WRITE_REFERENCE=1 cargo test -p sm2-cli --lib reference"
    );
}

fn table(rows: impl IntoIterator<Item = [String; 6]>) -> String {
    let mut table = String::from(
        "| limit | meaning | default | range | set by | shown by |\n| --- | --- | --- | --- | --- | --- |\n",
    );
    for [name, meaning, default, range, option, shown] in rows {
        // `write!` to a string cannot fail.
        let _ = writeln!(
            table,
            "| `{name}` | {meaning} | {default} | {range} | {option} | {shown} |"
        );
    }
    table
}

fn manager() -> String {
    table(Limit::ALL.map(|limit| {
        let range = limit.range();
        let value = match limit.unit() {
            Unit::Milliseconds => "MS",
            Unit::Count | Unit::Bytes => "N",
        };
        let option = format!("`--{} {value}`", limit.name().replace('_', "-"));
        let most = match limit.whole() {
            Some(whole) => format!("`{}`", whole.name()),
            None => limit.show(*range.end()).to_string(),
        };
        [
            limit.name().into(),
            limit.to_string(),
            limit.show(Limits::default().of(limit)).to_string(),
            format!("{} to {most}", limit.show(*range.start())),
            option,
            "`sm2 doctor`, `sm2 snapshot`".into(),
        ]
    }))
}

fn gateway() -> String {
    table(peer::Limit::ALL.map(|limit| {
        let most = match limit.whole() {
            Some(whole) => format!("`{}`", whole.name()),
            None => format!("{} bytes", limit.most()),
        };
        [
            limit.name().into(),
            limit.to_string(),
            format!("{} bytes", peer::Limits::default().of(limit)),
            format!("1 byte to {most}"),
            format!("`limits.{}` of the file", limit.name()),
            "`sm2 gateway peers`, `sm2 snapshot --json`".into(),
        ]
    }))
}

fn node() -> String {
    let rows = [
        [
            "max_len",
            "greatest length of a message that a subscriber, client or server accepts",
            &format!("{} bytes", MaxLen::DEFAULT.bytes()),
            &format!(
                "{} bytes to {} bytes",
                MaxLen::LEAST.bytes(),
                MaxLen::GREATEST.bytes()
            ),
            "`max_len` of their builders, `sm2 topic echo --max-len`",
            "`sm2 why`, `sm2 topic loss`",
        ],
        [
            "pool_limit",
            "greatest memory of the messages of a publisher",
            &format!(
                "{POOL_LIMIT_BYTES} bytes, or {POOL_LIMIT_MESSAGES} of the longest messages if that is more"
            ),
            "one message or more",
            "`pool_limit` of its builder, `sm2 topic pub --pool-limit`",
            "`sm2 topic loss`",
        ],
        [
            "max_mapped_bytes",
            "bytes that a node, and all nodes of a process together, map for their peers",
            &format!("{MAX_MAPPED_BYTES} bytes"),
            "any",
            "`NodeBuilder::max_mapped_bytes`",
            "the code `resources` of the links that end",
        ],
        [
            "max_links",
            "ends of links that a node can have at a time",
            "as many as the free descriptors of its process allow",
            "4 or more",
            "the limit of open files (`ulimit -n`)",
            "`sm2 snapshot --json`, `sm2 why`",
        ],
    ];
    table(rows.map(|row| row.map(str::to_owned)))
}
