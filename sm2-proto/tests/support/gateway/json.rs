//! Frames, headers and beacons of gateways as JSON, with the names of SPEC section 14. Vectors have
//! this form, and the two decoders are compared in it.

use serde_json::{Value, json};
use sm2_proto::{
    TypeId,
    gateway::{
        Beacon, BeaconError, Frame, Header, HeaderKind, Hop, Outcome, Subject, SubjectKind, Verdict,
    },
};

pub(crate) fn frame(frame: &Frame) -> Value {
    match frame {
        Frame::Hello {
            min_version,
            max_version,
            epoch,
            name,
        } => json!({"HELLO": {
            "min_version": min_version,
            "max_version": max_version,
            "epoch": epoch,
            "name": name.as_str(),
        }}),
        Frame::Offer {
            offer,
            subject: it,
            path,
        } => json!({"OFFER": {
            "offer": offer,
            "subject": subject(it),
            "path": path.iter().map(hop).collect::<Vec<_>>(),
        }}),
        Frame::Unoffer { offer } => json!({"UNOFFER": {"offer": offer}}),
        Frame::Unoffered { offer } => json!({"UNOFFERED": {"offer": offer}}),
        Frame::Want { offer, depth } => json!({"WANT": {"offer": offer, "depth": depth}}),
        Frame::Unwant { offer } => json!({"UNWANT": {"offer": offer}}),
        Frame::Unwanted { offer } => json!({"UNWANTED": {"offer": offer}}),
        Frame::Ask { ask, kind, name } => json!({"ASK": {
            "ask": ask,
            "kind": match kind {
                SubjectKind::Topic => "topic",
                SubjectKind::Service => "service",
            },
            "name": name.as_str(),
        }}),
        Frame::Answer { ask, verdict } => json!({"ANSWER": {
            "ask": ask,
            "verdict": match verdict {
                Verdict::Offered => "offered",
                Verdict::Denied => "denied",
                Verdict::Absent => "absent",
            },
        }}),
    }
}

fn subject(subject: &Subject) -> Value {
    match subject {
        Subject::Topic {
            name,
            data: it,
            reliable,
            latched,
        } => json!({"topic": {
            "name": name.as_str(),
            "data": data(it),
            "reliable": reliable,
            "latched": latched,
        }}),
        Subject::Service {
            name,
            request,
            reply,
        } => json!({"service": {
            "name": name.as_str(),
            "request": data(request),
            "reply": data(reply),
        }}),
    }
}

fn data(it: &TypeId) -> Value {
    json!({"name": it.name.as_str(), "hash": it.hash})
}

fn hop(hop: &Hop) -> Value {
    json!({"gateway": hop.gateway.to_string(), "epoch": hop.epoch})
}

pub(crate) fn header(header: &Header) -> Value {
    let (offer, len) = (header.offer, header.len);
    match header.kind {
        HeaderKind::Message { sequence, age_ns } => json!({"message": {
            "offer": offer,
            "sequence": sequence,
            "age": age_ns,
            "len": len,
        }}),
        HeaderKind::Request { left_ns } => {
            json!({"request": {"offer": offer, "left": left_ns, "len": len}})
        }
        HeaderKind::Reply { status } => json!({"reply": {
            "offer": offer,
            "status": match status {
                Outcome::Ok => "ok",
                Outcome::Failed => "failed",
                Outcome::Cancelled => "cancelled",
                Outcome::DeadlinePassed => "deadline-passed",
                Outcome::Unreachable => "unreachable",
                Outcome::Denied => "denied",
            },
            "len": len,
        }}),
    }
}

pub(crate) fn beacon(beacon: &Beacon) -> Value {
    json!({
        "port": beacon.port,
        "gateway": beacon.gateway.to_string(),
        "epoch": beacon.epoch,
    })
}

/// The part of a datagram that differs from the table of SPEC section 14.7.
pub(crate) const fn beacon_error(why: BeaconError) -> &'static str {
    match why {
        BeaconError::Length => "length",
        BeaconError::Magic => "magic",
        BeaconError::Version(_) => "version",
        BeaconError::NoPort => "port",
        BeaconError::ReservedNotZero => "zeros",
    }
}
