//! The tables of limits in `docs/src/limits.md` and SPEC.md, generated from the code. The book includes that of SPEC.
//!
//! `SM2_WRITE_REFERENCE=1 cargo test -p sm2-cli --lib reference` writes them.

use std::{env, fmt::Write as _, fs, path::Path};

use sm2_gateway::peer;
use sm2_node::{MAX_MAPPED_BYTES, POOL_LIMIT_BYTES, POOL_LIMIT_MESSAGES};
use sm2_proto::{
    control::{Limit, Limits},
    link::MaxLen,
};

#[test]
fn the_documents_have_the_limits_of_the_code() {
    for (document, tables) in [
        ("SPEC.md", &[("manager_limits", manager())][..]),
        (
            "docs/src/limits.md",
            &[("gateway_limits", gateway()), ("node_limits", node())],
        ),
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("..")
            .join(document);
        let found = fs::read_to_string(&path).unwrap();
        let expected = tables.iter().fold(found.clone(), |page, (name, table)| {
            let begin = format!("<!-- ANCHOR: {name} -->\n");
            let end = format!("<!-- ANCHOR_END: {name} -->");
            let (before, rest) = page.split_once(&begin).expect("the begin of the table");
            let (_, after) = rest.split_once(&end).expect("the end of the table");
            format!("{before}{begin}\n{table}\n{end}{after}")
        });
        if env::var_os("SM2_WRITE_REFERENCE").is_some() {
            fs::write(&path, &expected).unwrap();
            continue;
        }
        assert!(
            found == expected,
            "{document} is out of date: write it again with \
             SM2_WRITE_REFERENCE=1 cargo test -p sm2-cli --lib reference"
        );
    }
}

/// A table whose first column has names of the code.
fn table<const COLUMNS: usize>(
    titles: [&str; COLUMNS],
    rows: impl IntoIterator<Item = [String; COLUMNS]>,
) -> String {
    let mut table = format!(
        "| {} |\n|{}\n",
        titles.join(" | "),
        " --- |".repeat(COLUMNS)
    );
    for mut row in rows {
        row[0] = format!("`{}`", row[0]);
        // `write!` to a string cannot fail.
        let _ = writeln!(table, "| {} |", row.join(" | "));
    }
    table
}

fn manager() -> String {
    let titles = [
        "limit",
        "meaning",
        "default",
        "range",
        "what happens beyond",
    ];
    table(
        titles,
        Limit::ALL.map(|limit| {
            let range = limit.range();
            let most = match limit.whole() {
                Some(whole) => format!("`{}`", whole.name()),
                None => limit.show(*range.end()).to_string(),
            };
            [
                limit.name().into(),
                limit.to_string(),
                limit.show(Limits::default().of(limit)).to_string(),
                format!("{} to {most}", limit.show(*range.start())),
                limit.beyond().into(),
            ]
        }),
    )
}

/// The columns of the tables of gateways and nodes.
const TITLES: [&str; 6] = ["limit", "meaning", "default", "range", "set by", "shown by"];

fn gateway() -> String {
    table(
        TITLES,
        peer::Limit::ALL.map(|limit| {
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
        }),
    )
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
    table(TITLES, rows.map(|row| row.map(str::to_owned)))
}
