//! Time limits in tests. A loaded machine must not break a test, and no test may wait for ever.
//!
//! | rule | instead |
//! | --- | --- |
//! | no assertion that something took less than a time | assert an order, or count |
//! | no limit under 60 s on a wait that has to succeed | `sm2_test_support::SOON` |
//! | no wait for a message or a child process without a limit | the method with a limit, and `SOON` |
//!
//! `join` of a thread is allowed: it has no form with a limit, so the waits of the thread itself need one. Likewise
//! `wait` of a child process that was killed before.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use syn::{
    BinOp, Expr, ExprAwait, ExprBinary, ExprCall, ExprMethodCall, ExprTry, File, Item, ItemConst,
    ItemFn, ItemMod, Lit, Local, Macro, Member, Pat, Token, UnOp,
    parse::Parser,
    punctuated::Punctuated,
    spanned::Spanned,
    visit::{self, Visit},
};

use super::sources::Finding;

/// A shorter limit is one that load can exceed.
const LIMIT_MS_MIN: u64 = 60_000;

/// Folders below `tests` that hold no tests, and the crate with the limit. The threads of loom models are simulated.
const EXCLUDED: &[&str] = &[
    "tests/support",
    "tests/src/bin/soak",
    "tests/src/bin/attacks",
    "verification/loom-models",
];

/// Files without any of these texts break no rule.
const SIGNS: &[&str] = &["elapsed()", "_timeout(", ".recv()", ".wait()", "const SOON"];

/// Methods whose result has a value only if they succeeded in time.
const DEMANDING: &[&str] = &["call_timeout", "wait_connected_timeout"];

/// The options that limit how long `connect` may take.
const CONNECTING: &[&str] = &["manager_timeout", "startup_timeout"];

const ELAPSED: &str = "an assertion on elapsed time: assert an order, or count";
const LOCAL_LIMIT: &str = "a limit of its own: use sm2_test_support::SOON";
const ENDLESS: &str = "a wait without a limit: use one with sm2_test_support::SOON";

/// The lines of the tests in a file that break a rule.
pub(crate) fn hasty_tests(path: &Path, text: &str) -> Vec<Finding> {
    let is_excluded = EXCLUDED.iter().any(|it| path.starts_with(it));
    let is_test = is_test_file(path);
    if is_excluded || !SIGNS.iter().any(|it| text.contains(it)) {
        return Vec::new();
    }
    if !is_test && !text.contains("#[cfg(test)]") {
        return Vec::new();
    }
    let parsed = syn::parse_file(text);
    let parsed = parsed.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut constants = Constants::default();
    constants.visit_file(&parsed);
    let mut limits = Limits {
        constants: constants.0,
        is_channel: text.contains("mpsc") && !text.contains("sm2_node"),
        elapsed: BTreeSet::new(),
        is_killed: false,
        findings: BTreeSet::new(),
    };
    if is_test {
        limits.visit_file(&parsed);
    } else {
        test_modules(&parsed).for_each(|it| limits.visit_item_mod(it));
    }
    let finding = |(line, text)| Finding {
        file: path.to_owned(),
        line,
        text,
    };
    limits.findings.into_iter().map(finding).collect()
}

fn is_test_file(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut folders = path.parent().into_iter().flat_map(Path::components);
    name == "tests.rs" || name.ends_with("_tests.rs") || folders.any(|it| it.as_os_str() == "tests")
}

/// The modules of a file that only tests have.
fn test_modules(file: &File) -> impl Iterator<Item = &ItemMod> {
    file.items.iter().filter_map(|item| match item {
        Item::Mod(module) => {
            let mut lists = module
                .attrs
                .iter()
                .filter_map(|it| it.meta.require_list().ok());
            let is_test =
                lists.any(|it| it.path.is_ident("cfg") && it.tokens.to_string() == "test");
            is_test.then_some(module)
        }
        _ => None,
    })
}

/// The lengths of constants in milliseconds, by name.
#[derive(Default)]
struct Constants(BTreeMap<String, u64>);

impl<'ast> Visit<'ast> for Constants {
    fn visit_item_const(&mut self, it: &'ast ItemConst) {
        if let Some(ms) = length_ms(&it.expr, &self.0) {
            self.0.insert(it.ident.to_string(), ms);
        }
    }
}

/// The length of a duration: `Duration::from_…` of a number, or a constant.
fn length_ms(expr: &Expr, constants: &BTreeMap<String, u64>) -> Option<u64> {
    match expr {
        Expr::Path(it) => constants.get(&it.path.get_ident()?.to_string()).copied(),
        Expr::Call(call) => {
            let Expr::Path(function) = &*call.func else {
                return None;
            };
            let Some(Expr::Lit(number)) = call.args.first() else {
                return None;
            };
            let Lit::Int(number) = &number.lit else {
                return None;
            };
            let number: u64 = number.base10_parse().ok()?;
            match function.path.segments.last()?.ident.to_string().as_str() {
                "from_secs" => number.checked_mul(1_000),
                "from_millis" => Some(number),
                "from_micros" => Some(number / 1_000),
                "from_nanos" => Some(number / 1_000_000),
                _ => None,
            }
        }
        _ => None,
    }
}

struct Limits {
    constants: BTreeMap<String, u64>,
    /// Whether `recv_timeout` is a method of a channel of the standard library.
    is_channel: bool,
    /// The variables of the function that hold an elapsed time.
    elapsed: BTreeSet<String>,
    /// Whether the function has killed a process.
    is_killed: bool,
    findings: BTreeSet<(usize, String)>,
}

impl Limits {
    fn note(&mut self, at: &impl Spanned, text: &str) {
        self.findings
            .insert((at.span().start().line, text.to_owned()));
    }

    /// Whether the value of an expression is an elapsed time.
    fn is_elapsed(&self, expr: &Expr) -> bool {
        match expr {
            Expr::MethodCall(it) => it.method == "elapsed" || self.is_elapsed(&it.receiver),
            Expr::Path(it) => {
                let name = it.path.get_ident().map(ToString::to_string);
                name.is_some_and(|it| self.elapsed.contains(&it))
            }
            Expr::Binary(it) => self.is_elapsed(&it.left) || self.is_elapsed(&it.right),
            Expr::Cast(it) => self.is_elapsed(&it.expr),
            Expr::Paren(it) => self.is_elapsed(&it.expr),
            Expr::Reference(it) => self.is_elapsed(&it.expr),
            _ => false,
        }
    }

    /// Checks what an assertion claims.
    fn claim(&mut self, expr: &Expr) {
        match expr {
            Expr::Binary(ExprBinary {
                left, op, right, ..
            }) => match op {
                BinOp::Lt(_) | BinOp::Le(_) if self.is_elapsed(left) => self.note(expr, ELAPSED),
                BinOp::Gt(_) | BinOp::Ge(_) if self.is_elapsed(right) => self.note(expr, ELAPSED),
                BinOp::And(_) | BinOp::Or(_) => {
                    [left, right].into_iter().for_each(|it| self.claim(it))
                }
                _ => {}
            },
            Expr::Paren(it) => self.claim(&it.expr),
            Expr::Unary(it) if matches!(it.op, UnOp::Not(_)) => {}
            Expr::MethodCall(it)
                if it.method == "contains" && it.args.iter().any(|it| self.is_elapsed(it)) =>
            {
                self.note(expr, ELAPSED);
            }
            Expr::MethodCall(it) if it.method == "is_ok" => self.demand(&it.receiver, 1),
            Expr::MethodCall(it) if it.method == "is_some" => self.demand(&it.receiver, 1),
            _ => {}
        }
    }

    /// Checks a call that has to succeed. `depth`: how many times its result is unwrapped.
    fn demand(&mut self, expr: &Expr, depth: usize) {
        let call = match expr {
            Expr::Try(it) => return self.demand(&it.expr, depth + 1),
            Expr::MethodCall(it) if is_unwrap(it) => return self.demand(&it.receiver, depth + 1),
            Expr::MethodCall(it) => it,
            _ => return,
        };
        let name = call.method.to_string();
        let is_demanding = depth > 1
            || DEMANDING.contains(&&*name)
            || name.starts_with("wait_for_")
            || self.is_channel && name == "recv_timeout";
        let limit = match &*name {
            "connect" => connecting(call),
            _ if is_demanding && name.ends_with("_timeout") => Some(call),
            _ => None,
        };
        let mut lengths = limit.into_iter().flat_map(|it| &it.args);
        let short = lengths.find_map(|it| length_ms(it, &self.constants));
        if let Some(ms) = short.filter(|&it| it < LIMIT_MS_MIN) {
            let text =
                format!("a limit of {ms} ms on what has to succeed: use sm2_test_support::SOON");
            self.note(&call.method, &text);
        }
    }
}

fn is_unwrap(call: &ExprMethodCall) -> bool {
    call.method == "unwrap" || call.method == "expect"
}

/// The option in this chain of methods that limits how long `connect` may take.
fn connecting(call: &ExprMethodCall) -> Option<&ExprMethodCall> {
    match &*call.receiver {
        Expr::MethodCall(it) if CONNECTING.iter().any(|name| it.method == name) => Some(it),
        Expr::MethodCall(it) => connecting(it),
        _ => None,
    }
}

/// Whether this is, by its name, a child process of the standard library.
fn is_child(expr: &Expr) -> bool {
    match expr {
        Expr::Path(it) => {
            let name = it.path.get_ident().map(ToString::to_string);
            name.is_some_and(|it| it.contains("child"))
        }
        Expr::Field(it) => match &it.member {
            Member::Named(name) => name.to_string().contains("child"),
            Member::Unnamed(_) => true,
        },
        Expr::MethodCall(it) => it.method == "spawn" || is_unwrap(it) && is_child(&it.receiver),
        _ => false,
    }
}

impl<'ast> Visit<'ast> for Limits {
    fn visit_item_const(&mut self, it: &'ast ItemConst) {
        if it.ident == "SOON" {
            self.note(&it.ident, LOCAL_LIMIT);
        }
    }

    fn visit_item_fn(&mut self, it: &'ast ItemFn) {
        self.elapsed.clear();
        self.is_killed = false;
        visit::visit_item_fn(self, it);
    }

    fn visit_impl_item_fn(&mut self, it: &'ast syn::ImplItemFn) {
        self.elapsed.clear();
        self.is_killed = false;
        visit::visit_impl_item_fn(self, it);
    }

    fn visit_local(&mut self, it: &'ast Local) {
        if let (Pat::Ident(name), Some(init)) = (&it.pat, &it.init)
            && self.is_elapsed(&init.expr)
        {
            self.elapsed.insert(name.ident.to_string());
        }
        visit::visit_local(self, it);
    }

    fn visit_macro(&mut self, it: &'ast Macro) {
        let parser = Punctuated::<Expr, Token![,]>::parse_terminated;
        let Ok(arguments) = parser.parse2(it.tokens.clone()) else {
            return;
        };
        let is_assertion = ["assert", "debug_assert"]
            .iter()
            .any(|name| it.path.is_ident(name));
        if is_assertion && let Some(condition) = arguments.first() {
            self.claim(condition);
        }
        arguments.iter().for_each(|it| visit_argument(self, it));
    }

    fn visit_expr_try(&mut self, it: &'ast ExprTry) {
        self.demand(&it.expr, 1);
        visit::visit_expr_try(self, it);
    }

    fn visit_expr_await(&mut self, it: &'ast ExprAwait) {
        // `recv` of a future waits no longer than the future lives.
        match &*it.base {
            Expr::MethodCall(call) if call.method == "recv" => self.visit_expr(&call.receiver),
            base => self.visit_expr(base),
        }
    }

    fn visit_expr_call(&mut self, it: &'ast ExprCall) {
        let is_timeout = match &*it.func {
            Expr::Path(path) => path
                .path
                .segments
                .last()
                .is_some_and(|it| it.ident == "timeout"),
            _ => false,
        };
        if !is_timeout {
            visit::visit_expr_call(self, it);
        }
    }

    fn visit_expr_method_call(&mut self, it: &'ast ExprMethodCall) {
        if is_unwrap(it) {
            self.demand(&it.receiver, 1);
        }
        if it.method == "kill" {
            self.is_killed = true;
        }
        let is_endless =
            it.method == "recv" || it.method == "wait" && is_child(&it.receiver) && !self.is_killed;
        if is_endless && it.args.is_empty() {
            self.note(&it.method, ENDLESS);
        }
        visit::visit_expr_method_call(self, it);
    }
}

/// Visits an argument of a macro, which lives no longer than this call.
fn visit_argument(limits: &mut Limits, expr: &Expr) {
    limits.visit_expr(expr);
}
