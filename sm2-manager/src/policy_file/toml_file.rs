//! The tables and keys of a policy file, as TOML has them.

use serde::Deserialize;
use sm2_proto::policy::Effect;
use toml::Spanned;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) default: EffectWord,
    #[serde(default)]
    pub(super) rule: Vec<Spanned<RuleTable>>,
    #[serde(default)]
    pub(super) binding: Vec<Spanned<BindingTable>>,
    #[serde(default)]
    pub(super) exclusive: Vec<Spanned<ExclusiveTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RuleTable {
    pub(super) name: Option<Spanned<String>>,
    pub(super) effect: EffectWord,
    pub(super) actions: Option<List>,
    pub(super) names: List,
    pub(super) users: Option<Spanned<Vec<Spanned<Id>>>>,
    pub(super) groups: Option<Spanned<Vec<Spanned<Id>>>>,
    pub(super) nodes: Option<List>,
    pub(super) peers: Option<List>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BindingTable {
    pub(super) name: Option<Spanned<String>>,
    pub(super) nodes: List,
    pub(super) users: Option<Spanned<Vec<Spanned<Id>>>>,
    pub(super) groups: Option<Spanned<Vec<Spanned<Id>>>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExclusiveTable {
    pub(super) name: Option<Spanned<String>>,
    pub(super) topics: List,
}

/// A list of patterns or actions.
pub(super) type List = Spanned<Vec<Spanned<String>>>;

/// A user or a group.
#[derive(Deserialize)]
#[serde(untagged, expecting = "expected a name, or an id from 0 to 4294967295")]
pub(super) enum Id {
    Number(u32),
    Name(String),
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum EffectWord {
    Allow,
    Deny,
}

impl From<EffectWord> for Effect {
    fn from(word: EffectWord) -> Self {
        match word {
            EffectWord::Allow => Self::Allow,
            EffectWord::Deny => Self::Deny,
        }
    }
}

impl File {
    /// The names of all tables: those of the file, else their kind and their number from 1.
    pub(super) fn names(&self) -> Vec<String> {
        let rules = self.rule.iter().map(|it| &it.get_ref().name);
        let bindings = self.binding.iter().map(|it| &it.get_ref().name);
        let exclusive = self.exclusive.iter().map(|it| &it.get_ref().name);
        let rules = (1..).map(|it| format!("rule-{it}")).zip(rules);
        let bindings = (1..).map(|it| format!("binding-{it}")).zip(bindings);
        let exclusive = (1..).map(|it| format!("exclusive-{it}")).zip(exclusive);
        let all = rules.chain(bindings).chain(exclusive);
        let named = all.map(|(numbered, name)| {
            let name = name.as_ref().map(|it| it.get_ref().clone());
            name.unwrap_or(numbered)
        });
        named.collect()
    }
}
