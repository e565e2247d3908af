//! Every limit of the protocol in one place.

/// The longest datagram, in bytes.
//= SM2-TRN-004
pub const DATAGRAM_MAX: usize = 65_536;
/// The longest name, in bytes.
pub const NAME_MAX: usize = 255;
/// The longest inline payload, in bytes.
pub const INLINE_MAX: usize = 61_440;
/// The longest message, in bytes.
pub const MESSAGE_MAX: u64 = 1 << 40;
/// The largest `depth`, `latched` and `max_borrowed`.
pub const QOS_MAX: u16 = 1_024;
/// The most unreleased messages that a side may accept.
pub const WINDOW_MAX: u32 = 2_048;
/// The most calls of one link without a reply.
pub const CALLS_MAX: usize = 1_024;
/// The most bytes of a frame between gateways, without its length.
pub const GATEWAY_FRAME_MAX: usize = 65_536;
/// The most gateways that a message passes, its origin included.
pub const HOPS_MAX: usize = 8;
/// The most datagrams per second that a gateway searches for beacons.
pub const BEACONS_PER_S: u32 = 256;
/// The most offers of one gateway to another that are not withdrawn.
pub const OFFERS_MAX: usize = 4_096;
/// The most requests of one gateway to another without an answer.
pub const QUESTIONS_MAX: usize = 64;
/// The most messages of topics that a gateway has in flight to one peer.
pub const MESSAGES_IN_FLIGHT_MAX: usize = 64;
/// The most segments attached at a time, per link and direction.
pub const SEGMENTS_MAX: usize = 256;
/// The most links that one interface has at a time, whatever the Manager's quota.
pub const LINKS_MAX: usize = 65_536;
/// The most publishers without a link whose publications a subscriber remembers.
//= SM2-QOS-013
pub const ABSENCES_MAX: usize = 256;
/// The largest segment or sealed file, in bytes.
pub const SEGMENT_BYTES_MAX: u64 = 1 << 41;
/// The most slots in one segment.
pub const SLOTS_MAX: u32 = 65_536;
/// A segment's stride is a multiple of this, in bytes: the size of a cache line, and the greatest
/// alignment of a slot.
pub const STRIDE_UNIT: u64 = 64;
/// The most sequence numbers in one RELEASE.
pub const RELEASE_MAX: usize = 512;
/// The length of the header of DATA, REQUEST and REPLY, in bytes.
pub const MESSAGE_HEAD: usize = 48;
/// The longest schema text, in bytes.
pub const SCHEMA_TEXT_MAX: usize = 32_768;
/// The most brackets that are open at any place of a schema text.
pub const SCHEMA_DEPTH_MAX: usize = 64;
/// Segments on the ring lane have numbers below this one.
pub const RING_SEGMENTS_MAX: u32 = 32_768;
/// How many messages of a ring may be displaced in a row before its receiver counts as stopped. Up to
/// this number the low halves of sequence numbers tell how often the sender went round.
//= SM2-RNG-010
pub const RING_DISPLACED_MAX: u32 = 1 << 31;
/// The length of the head at the end of a slot, in bytes.
pub const SLOT_HEAD: usize = 64;
/// The greatest number of payload bytes of a message in a cell of a ring.
pub const CELL_MAX: usize = 104;
/// The size of items that ends a PAGE of the Manager, in bytes.
pub const PAGE_BYTES: usize = 32_768;
/// The longest text that a Manager sends with RELOADED, in bytes.
pub const RELOAD_TEXT_MAX: usize = 1_024;
/// The most rules, bindings and exclusive entries of an access policy.
pub const POLICY_TABLES_MAX: usize = 1_024;
/// The most patterns, users and groups of an access policy.
pub const POLICY_TERMS_MAX: usize = 8_192;
/// The longest policy file, in bytes.
pub const POLICY_FILE_MAX: u64 = 1 << 20;

const _: () = assert!(SLOT_HEAD as u64 <= STRIDE_UNIT);
const _: () = assert!(MESSAGE_HEAD + INLINE_MAX <= DATAGRAM_MAX);
const _: () = assert!(8 + 8 * RELEASE_MAX <= DATAGRAM_MAX);
const _: () = assert!(QOS_MAX as u32 * 2 <= WINDOW_MAX);
const _: () = assert!(MESSAGE_MAX <= SEGMENT_BYTES_MAX);
const _: () = assert!(SCHEMA_TEXT_MAX + NAME_MAX + 32 < DATAGRAM_MAX);
const _: () = assert!(PAGE_BYTES + 8 * (NAME_MAX + 16) < DATAGRAM_MAX);
/// The most members of a lockstep (SM2-LCK-010).
pub const LOCKSTEP_MEMBERS_MAX: usize = 1_024;
/// The most rounds of a step of a lockstep (SM2-LCK-009).
pub const LOCKSTEP_ROUNDS_MAX: u64 = 10_000;
