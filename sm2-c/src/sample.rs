//! Received messages.

use std::ffi::{c_char, c_void};
use std::mem::MaybeUninit;

use crate::aligned::AlignedCopy;
use crate::arguments::{Out, given, sized, store_bytes};
use crate::status::{Failure, Status, guard, guard_drop};

/// A received message: see `sm2_subscriber_recv()`.
#[derive(Debug, Default)]
pub struct Sample {
    /// `None` once the message is released.
    sample: Option<sm2_node::Sample<[u8]>>,
    copy: AlignedCopy,
}

// A program may release a sample on another thread than the one that took it, and read it on several, as the header
// says.
const _: fn() = || {
    fn can_be_shared<T: Send + Sync>() {}
    can_be_shared::<Sample>();
};

/// Number, time, type and publisher of a message.
#[repr(C)]
#[derive(Debug)]
pub struct SampleInfo {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// The number of the publication, from 1.
    pub sequence: u64,
    /// The time of publication, in nanoseconds of `CLOCK_MONOTONIC`.
    pub source_time_ns: u64,
    /// How many messages of this publisher were lost since the sample before.
    pub lost: u64,
    /// The hash of the type that the publisher declared; 0 for raw bytes.
    pub type_hash: u64,
    /// The name of the type that the publisher declared; `bytes` for raw bytes. Has no NUL at its end, and is valid as
    /// long as the sample holds this message.
    pub type_name: *const c_char,
    /// The length of `type_name`.
    pub type_name_len: usize,
    /// The name of the publisher's node, of the same kind as `type_name`.
    pub publisher: *const c_char,
    /// The length of `publisher`.
    pub publisher_len: usize,
}

sized! { SampleInfo, publisher_len: usize = "sm2_sample_info_t"; }

impl Sample {
    pub(crate) fn release(&mut self) {
        self.sample = None;
    }

    pub(crate) fn fill(&mut self, sample: sm2_node::Sample<[u8]>) {
        self.copy.align(&sample);
        self.sample = Some(sample);
    }

    fn held(&self) -> Result<&sm2_node::Sample<[u8]>, Failure> {
        (self.sample.as_ref()).ok_or_else(|| {
            Failure::misuse("the sample is empty: its message was released; receive another one")
        })
    }
}

/// Stores the bytes of a message in `data`, and their number in `len`. The bytes are in the memory that the publisher
/// wrote, are aligned to 64 bytes, and do not change until the sample is released, freed or used again. Only messages
/// of at most 104 bytes, and short messages of links without a ring, may be copies.
///
/// Errors: `SM2_MISUSE`, also if the sample is empty.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_sample_data(
    sample: Option<&Sample>,
    data: Option<&mut MaybeUninit<*const c_void>>,
    len: Option<&mut MaybeUninit<usize>>,
) -> Status {
    guard(|| {
        let sample = given(sample, "sample")?;
        let bytes = sample.copy.of(sample.held()?);
        store_bytes(bytes, data, "data", len)
    })
}

/// Fills `info`: number, time, loss, type and publisher of a message.
///
/// Errors: `SM2_MISUSE`, also if the sample is empty.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_sample_info(sample: Option<&Sample>, info: *mut SampleInfo) -> Status {
    guard(|| {
        let info = Out(info).required("info")?;
        let sample = given(sample, "sample")?.held()?;
        let publisher = sample.publisher().as_str();
        let data = sample.type_id();
        let type_name = data.map_or("", |it| it.name.as_str());
        info.write(&SampleInfo {
            size: size_of::<SampleInfo>(),
            sequence: sample.sequence(),
            source_time_ns: sample.source_time().0,
            lost: sample.lost(),
            type_hash: data.map_or(0, |it| it.hash),
            type_name: type_name.as_ptr().cast(),
            type_name_len: type_name.len(),
            publisher: publisher.as_ptr().cast(),
            publisher_len: publisher.len(),
        });
        Ok(())
    })
}

/// Releases the message of a sample, so that its publisher can use the memory again. The handle stays, for another
/// `sm2_subscriber_recv()`.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, but no other call may use this sample at the same time. The subscriber, the node and the publisher may
/// have ended.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_sample_release(sample: Option<&mut Sample>) -> Status {
    guard(|| {
        given(sample, "sample")?.release();
        Ok(())
    })
}

/// Frees a sample, and releases its message; NULL is ignored.
///
/// Threads: any, but no other call may use this handle at the same time or later. The subscriber, the node and the
/// publisher may have ended.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_sample_free(sample: Option<Box<Sample>>) {
    guard_drop(sample);
}
