//! The texts of verdicts: what stands between two interfaces, and what to do about it.

use std::fmt;

use sm2_proto::{Code, EntityId, Farewell, Kind, NodeId, Period, Refusal, text::Counted};

use super::{Finding, NearName, Part, Party, Reliability, Seal, TypePair, Verdict};

impl fmt::Display for Party {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            entity,
            node,
            kind,
            name,
            ..
        } = self;
        match (node, kind, name) {
            (Some(node), Some(kind), Some(name)) => write!(f, "{node}'s {kind} of {name}"),
            (None, Some(kind), Some(name)) => write!(f, "the {kind} of {name} of {}", entity.node),
            (Some(node), ..) if self.is_node() => write!(f, "node {node} itself"),
            (Some(node), ..) => write!(f, "{} of {node}", entity.interface),
            (None, ..) if self.is_node() => write!(f, "{}", entity.node),
            (None, ..) => write!(f, "{entity}"),
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            one,
            other,
            finding,
        } = self;
        match finding {
            Finding::Unknown { entity } => write_unknown(f, self.party(*entity)),
            Finding::Linked {
                reliability,
                sealed,
                ..
            } => {
                write!(f, "{one} and {other} are linked.\n{reliability}; ")?;
                self.write_seals(f, sealed)
            }
            Finding::Kinds => self.write_kinds(f),
            Finding::Names { near } => {
                write!(f, "{one} and {other}: their names differ")?;
                match near {
                    Some(near) => write!(f, " ({near}).\nIf they mean the same, rename one."),
                    None => f.write_str(".\nOnly equal names are linked."),
                }
            }
            Finding::Refused {
                entity,
                reason,
                against,
            } => write_refused(f, self.party(*entity), reason, against.as_ref()),
            Finding::Types { differ } => {
                write!(f, "{one} and {other}: their types differ.")?;
                differ.iter().try_for_each(|it| write!(f, "\n{it}"))
            }
            Finding::Reliability => self.write_reliability(f),
            Finding::Deadline { offered, demanded } => {
                self.write_periods(f, "deadline", *offered, *demanded)
            }
            Finding::Liveliness { offered, demanded } => {
                self.write_periods(f, "liveliness lease", *offered, *demanded)
            }
            Finding::Claimed { by, .. } => self.write_claimed(f, *by),
            Finding::Resuming { nodes } => {
                write!(f, "{one} and {other} match, but the new Manager waits for ")?;
                self.write_nodes(f, nodes)?;
                f.write_str(" to claim existing links.\nThat takes a moment: ask again.")
            }
            Finding::Ended { code } => self.write_ended(f, *code),
            Finding::Quota { node, limit } => self.write_quota(f, *node, *limit),
            Finding::NoRoom {
                node,
                used,
                max_links,
            } => self.write_no_room(f, *node, [*used, *max_links]),
            Finding::Waiting { .. } => write!(
                f,
                "{one} and {other} match, but one of their nodes has not read all that the Manager sent.\n\
                 They are linked as soon as it has. If that does not last, its program does not run."
            ),
            Finding::Descriptors => write!(
                f,
                "{one} and {other} match, but the Manager had no descriptors for a link.\n\
                 Raise the Manager's limit of open files and declare one of them again."
            ),
            Finding::Due => write!(
                f,
                "{one} and {other} match, and nothing prevents a link.\n\
                 If they are not linked in a moment, the Manager's log says why."
            ),
        }
    }
}

impl Verdict {
    fn party(&self, entity: EntityId) -> &Party {
        if self.other.entity == entity {
            &self.other
        } else {
            &self.one
        }
    }

    fn write_reliability(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { one, other, .. } = self;
        write!(
            f,
            "{other} demands reliability, which {one} does not offer.\n\
             Make the publisher reliable, or the subscriber best-effort."
        )
    }

    fn write_periods(
        &self,
        f: &mut fmt::Formatter<'_>,
        name: &str,
        offered: Period,
        demanded: Period,
    ) -> fmt::Result {
        let Self { one, other, .. } = self;
        write!(
            f,
            "{other} demands a {name} of {demanded}, and {one} offers "
        )?;
        match offered.get() {
            None => writeln!(f, "no {name}.")?,
            Some(_) => writeln!(f, "{offered}.")?,
        }
        write!(
            f,
            "Let the publisher offer a {name} of at most {demanded}, or the subscriber demand a longer one."
        )
    }

    fn write_kinds(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { one, other, .. } = self;
        let (Some(kind), Some(theirs)) = (one.kind, other.kind) else {
            return write!(f, "{one} and {other} are not counterparts.");
        };
        if one.entity == other.entity {
            write!(f, "{one} is one interface: a link joins two.")?;
        } else if kind == theirs {
            write!(f, "{one} and {other} are both {kind}s.")?;
        } else {
            write!(f, "{one} and {other} are not counterparts.")?;
        }
        write!(f, "\nA {kind} is linked with {}s only", kind.counterpart())?;
        if kind != theirs {
            write!(f, ", and a {theirs} with {}s", theirs.counterpart())?;
        }
        f.write_str(".")
    }

    fn write_seals(&self, f: &mut fmt::Formatter<'_>, seals: &[Seal]) -> fmt::Result {
        if seals.is_empty() {
            return f.write_str(
                "not sealed: neither side asks for it and no policy demands it, so the sender \
                 could still change a message after it was sent.",
            );
        }
        f.write_str("sealed, since ")?;
        for (at, seal) in seals.iter().enumerate() {
            if at > 0 {
                f.write_str(" and ")?;
            }
            match seal {
                Seal::Asked { by } => write!(f, "{} asks for it", self.party(*by))?,
                Seal::Policy => f.write_str("the domain seals every link")?,
                Seal::Users => f.write_str("they belong to different users")?,
                Seal::Kept => f.write_str("it was when an earlier Manager made it")?,
            }
        }
        f.write_str(".")
    }

    fn write_claimed(&self, f: &mut fmt::Formatter<'_>, by: EntityId) -> fmt::Result {
        let by = self.party(by);
        let absent = if *by == self.one {
            &self.other
        } else {
            &self.one
        };
        write!(
            f,
            "{by} has claimed a link from the new Manager; {absent} has not claimed it yet.\n\
             It has a few seconds for that. The link works meanwhile."
        )
    }

    fn write_ended(&self, f: &mut fmt::Formatter<'_>, code: Code) -> fmt::Result {
        let Self { one, other, .. } = self;
        write!(
            f,
            "{one} and {other} match, but one of them ended their link: "
        )?;
        match Farewell::from_code(code) {
            Some(farewell) => f.write_str(meaning(farewell))?,
            None => write!(f, "{code}")?,
        }
        f.write_str(match Farewell::from_code(code) {
            Some(Farewell::Resources) => {
                ".\nThe Manager links them again soon. If that does not last, raise the limit of open \
                 files (ulimit -n) of both programs."
            }
            _ => ".\nThey are not linked again until one of them is declared anew.",
        })
    }

    fn write_quota(&self, f: &mut fmt::Formatter<'_>, node: NodeId, limit: u32) -> fmt::Result {
        let Self { one, other, .. } = self;
        write!(f, "{one} and {other} match, but ")?;
        self.write_nodes(f, &[node])?;
        write!(
            f,
            " may not have more than {}.\n\
             Close some and declare again, or have the operator raise links_per_session of the Manager.",
            Counted::new(limit.into(), "link")
        )
    }

    fn write_no_room(
        &self,
        f: &mut fmt::Formatter<'_>,
        node: NodeId,
        [used, max_links]: [u32; 2],
    ) -> fmt::Result {
        let Self { one, other, .. } = self;
        write!(f, "{one} and {other} match, but node ")?;
        self.write_nodes(f, &[node])?;
        write!(
            f,
            " has no room for more links: {used} of {max_links}.\n\
             Raise the limit of open files of its program (ulimit -n), or end some of its links. They \
             are linked as soon as there is room."
        )
    }

    fn write_nodes(&self, f: &mut fmt::Formatter<'_>, nodes: &[NodeId]) -> fmt::Result {
        for (at, node) in nodes.iter().enumerate() {
            if at > 0 {
                f.write_str(" and ")?;
            }
            let ours = [&self.one, &self.other];
            let party = ours.into_iter().find(|it| it.entity.node == *node);
            match party.and_then(|it| it.node.as_ref()) {
                Some(name) => write!(f, "{name}")?,
                None => write!(f, "{node}")?,
            }
        }
        Ok(())
    }
}

fn write_unknown(f: &mut fmt::Formatter<'_>, party: &Party) -> fmt::Result {
    if party.is_node() {
        write!(
            f,
            "{party} is not an interface.\nName one of its interfaces."
        )
    } else {
        write!(
            f,
            "there is no {party}.\nIt is gone, or never was: see what the domain shows now."
        )
    }
}

fn write_refused(
    f: &mut fmt::Formatter<'_>,
    party: &Party,
    reason: &Refusal,
    against: Option<&Party>,
) -> fmt::Result {
    write!(f, "{party} was refused: {reason}")?;
    match (reason, against) {
        (_, Some(against)) => write!(
            f,
            ", as {against} states.\nUse one type for both, or another name for one of them."
        ),
        (Refusal::TopicType { .. } | Refusal::ServiceType { .. }, None) => {
            f.write_str(".\nThe interface that stated that type is gone by now: declare again.")
        }
        (
            Refusal::Quota { .. }
            | Refusal::NameTaken
            | Refusal::Version { .. }
            | Refusal::Denied { .. }
            | Refusal::Exclusive { .. },
            None,
        ) => f.write_str("."),
    }
}

impl fmt::Display for NearName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Case => "in upper and lower case only",
            Self::Edit => "by one character only",
            Self::Segments => "one is the other without some segments",
            Self::Leading => "in the last segment only",
        })
    }
}

impl fmt::Display for Reliability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Service => "reliable, as all links of services",
            Self::Demanded => "reliable, since the subscriber demands it",
            Self::NotDemanded => "not reliable, since the subscriber does not demand it",
            Self::NotOffered => "not reliable, since the publisher does not offer it",
        })
    }
}

impl fmt::Display for TypePair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            part,
            offered,
            demanded,
            difference,
        } = self;
        let (offers, demands) = match part {
            Part::Messages => (Kind::Publisher, Kind::Subscriber),
            Part::Requests | Part::Replies => (Kind::Server, Kind::Client),
        };
        if offered.name == demanded.name {
            write!(
                f,
                "{part}: both are named {}, but the schemas differ ({:016x} of the {offers}, \
                 {:016x} of the {demands}): build both from the same definition",
                offered.name, offered.hash, demanded.hash
            )?;
        } else {
            write!(
                f,
                "{part}: {} of the {offers}, {} of the {demands}: one of them has to change",
                offered.name, demanded.name
            )?;
            if offered.hash == demanded.hash {
                f.write_str(" its name only")?;
            }
        }
        match difference {
            Some(difference) => write!(
                f,
                "; first difference (here: {offers}, there: {demands}): {difference}."
            ),
            None => f.write_str("."),
        }
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Messages => "messages",
            Self::Requests => "requests",
            Self::Replies => "replies",
        })
    }
}

const fn meaning(farewell: Farewell) -> &'static str {
    match farewell {
        Farewell::Done => "it was no longer needed",
        Farewell::GreetingTimeout => "it did not greet in time",
        Farewell::Stalled => "the other one did not read what was sent to it",
        Farewell::ShuttingDown => "it was shutting down",
        Farewell::Resources => "it ran out of descriptors, memory or quota",
        Farewell::PeerGone => "the other end was gone without a farewell",
        Farewell::NotAdopted => "the new Manager could not take the link over",
        Farewell::Denied => "the access policy denied it",
    }
}
