//! The arguments of a C program, checked: texts, bytes, structs with a size, and places for results.
//!
//! Each entry point wraps the pointers of its C caller in a [`Text`], [`Bytes`], [`In`] or [`Out`], and nothing else
//! makes such a value. The header states what each pointer must be, so the methods here rely on that. Handles need no
//! wrapper: `Option<&T>` and `Option<Box<T>>` have the layout of a pointer that may be NULL.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::mem::MaybeUninit;
use std::ops::RangeInclusive;
use std::os::fd::{AsFd, AsRawFd};
use std::ptr::NonNull;
use std::time::Duration;

use crate::status::Failure;

/// A time without limit, in nanoseconds: `UINT64_MAX`.
pub const FOREVER: u64 = u64::MAX;

/// Returns a handle or place that must not be NULL.
pub(crate) fn given<T>(argument: Option<T>, name: &str) -> Result<T, Failure> {
    argument.ok_or_else(|| null(name))
}

fn null(name: &str) -> Failure {
    Failure::misuse(format!("the argument '{name}' is NULL: pass a value"))
}

/// A time limit or a period. `FOREVER` is the longest one.
pub(crate) const fn duration(ns: u64) -> Duration {
    match ns {
        FOREVER => Duration::MAX,
        ns => Duration::from_nanos(ns),
    }
}

/// A period; 0 is none.
pub(crate) const fn period(ns: u64) -> Option<Duration> {
    match ns {
        0 => None,
        ns => Some(duration(ns)),
    }
}

/// The nanoseconds of a time, at most `FOREVER`.
pub(crate) fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(FOREVER)
}

/// A text: UTF-8 that ends with NUL.
pub(crate) struct Text(pub(crate) *const c_char);

impl Text {
    /// The text; `None` for NULL.
    pub(crate) fn optional(&self, name: &str) -> Result<Option<&str>, Failure> {
        let Some(pointer) = NonNull::new(self.0.cast_mut()) else {
            return Ok(None);
        };
        // SAFETY: the header demands a text that ends with NUL, and that no thread changes it during the call. The
        // result does not outlive `self`, which is an argument of the call, or a field of a struct that it has copied.
        let text = unsafe { CStr::from_ptr(pointer.as_ptr()) };
        match text.to_str() {
            Ok(text) => Ok(Some(text)),
            Err(_) => Err(Failure::misuse(format!(
                "the text '{name}' is not UTF-8: {text:?}"
            ))),
        }
    }

    pub(crate) fn required(&self, name: &str) -> Result<&str, Failure> {
        given(self.optional(name)?, name)
    }
}

/// The first of the bytes that a program passes.
pub(crate) struct Bytes(pub(crate) *const c_void);

impl Bytes {
    /// The `len` bytes. NULL only if there are none.
    pub(crate) fn slice(&self, len: usize, name: &str) -> Result<&[u8], Failure> {
        if len == 0 {
            return Ok(&[]);
        }
        let bytes = given(NonNull::new(self.0.cast_mut()), name)?;
        if isize::try_from(len).is_err() {
            return Err(Failure::misuse(format!(
                "the argument '{name}' cannot have {len} bytes: no object is that long"
            )));
        }
        // SAFETY: the header demands `len` readable bytes that no thread changes during the call; `len` is within the
        // bound of a slice. The result does not outlive `self`, which is an argument of the call.
        Ok(unsafe { std::slice::from_raw_parts(bytes.as_ptr().cast(), len) })
    }
}

/// A struct that may grow in later versions: its first field is its size.
///
/// # Safety
///
/// The type is `repr(C)`, its first field is a `usize`, and every pattern of bits is a value of the type: it consists
/// of integers and raw pointers. It has no padding behind its last field, which an older program would leave
/// uninitialized where a newer library has a field.
pub(crate) unsafe trait Struct {
    /// The name of the struct in C.
    const NAME: &'static str;
}

/// Declares that structs follow the rules of [`Struct`], and checks that there is no padding behind the last field.
macro_rules! sized {
    ($($type:ty, $last:ident: $last_type:ty = $name:literal;)*) => {
        $(
            const _: () = assert!(
                size_of::<$type>() == std::mem::offset_of!($type, $last) + size_of::<$last_type>()
            );
            // SAFETY: the struct is `repr(C)`, begins with `size`, consists of integers and raw pointers, and has no
            // padding at its end, which the assertion above checks.
            unsafe impl $crate::arguments::Struct for $type {
                const NAME: &'static str = $name;
            }
        )*
    };
}
pub(crate) use sized;

/// The sizes that a struct of any version may have, in bytes. Another one was not set.
const STRUCT_SIZES: RangeInclusive<usize> = size_of::<usize>()..=4_096;

/// Reads the field `size` and checks it.
fn size_at<T: Struct>(place: NonNull<T>) -> Result<usize, Failure> {
    // SAFETY: the header demands a struct whose field `size` is set; it is the first one (`Struct`).
    let size = unsafe { place.cast::<usize>().read() };
    match STRUCT_SIZES.contains(&size) {
        true => Ok(size),
        false => Err(Failure::misuse(format!(
            "the field 'size' of a {name} is {size}: set it to sizeof({name})",
            name = T::NAME
        ))),
    }
}

/// A struct that a program passes, or NULL for its defaults.
pub(crate) struct In<T>(pub(crate) *const T);

impl<T: Struct> In<T> {
    /// The struct; `None` for NULL. Fields that the program's version does not know have the values of `defaults`.
    pub(crate) fn read(&self, defaults: impl FnOnce() -> T) -> Result<Option<T>, Failure> {
        let Some(place) = NonNull::new(self.0.cast_mut()) else {
            return Ok(None);
        };
        let size = size_at(place)?;
        let known = size.min(size_of::<T>());
        // SAFETY: the header demands that `size` bytes are initialized. The rest is beyond the fields that this
        // library knows.
        let rest = unsafe {
            std::slice::from_raw_parts(place.cast::<u8>().add(known).as_ptr(), size - known)
        };
        if rest.iter().any(|it| *it != 0) {
            return Err(Failure::misuse(format!(
                "a {} of {size} bytes sets an option that this library does not know, whose struct has {known} \
                 bytes: update the library, or leave the option at 0",
                T::NAME
            )));
        }
        let mut value = defaults();
        // SAFETY: `known` bytes are readable at `place`, as above, and at most the size of `value`, which is another
        // object. Every pattern of bits is a `T` (`Struct`).
        unsafe {
            let to = (&raw mut value).cast::<u8>();
            std::ptr::copy_nonoverlapping(place.cast::<u8>().as_ptr(), to, known);
        }
        Ok(Some(value))
    }

    pub(crate) fn read_or(&self, defaults: impl Fn() -> T) -> Result<T, Failure> {
        Ok(self.read(&defaults)?.unwrap_or_else(defaults))
    }
}

/// A struct that a call fills, or NULL if the program does not want it.
pub(crate) struct Out<T>(pub(crate) *mut T);

/// The place of an [`Out`] whose size was checked.
pub(crate) struct Place<T> {
    pointer: NonNull<T>,
    size: usize,
}

impl<T: Struct> Out<T> {
    /// Checks the place before the call has done anything.
    pub(crate) fn optional(&self) -> Result<Option<Place<T>>, Failure> {
        let Some(pointer) = NonNull::new(self.0) else {
            return Ok(None);
        };
        let size = size_at(pointer)?;
        Ok(Some(Place { pointer, size }))
    }

    pub(crate) fn required(&self, name: &str) -> Result<Place<T>, Failure> {
        given(self.optional()?, name)
    }
}

/// Fills a struct of options, which must not be NULL, with the defaults.
pub(crate) fn set_defaults<T: Struct>(options: *mut T, defaults: &T) -> Result<(), Failure> {
    Out(options).required("options")?.write(defaults);
    Ok(())
}

impl<T: Struct> Place<T> {
    /// Writes all fields but `size`. Fields that this library does not know become 0.
    pub(crate) fn write(self, value: &T) {
        let head = size_of::<usize>();
        let known = self.size.min(size_of::<T>());
        let from = std::ptr::from_ref(value).cast::<u8>();
        let to = self.pointer.as_ptr().cast::<u8>();
        // SAFETY: the header demands that `size` bytes are writable, and that no other thread uses them. `known` is at
        // most that and the size of `value`, which is another object; `size_at` checked that `head <= size`.
        unsafe {
            std::ptr::copy_nonoverlapping(from.add(head), to.add(head), known - head);
            to.add(known).write_bytes(0, self.size - known);
        }
    }
}

/// Returns the place for a handle, which is NULL until the call writes a handle.
pub(crate) fn vacant<'a, T>(
    place: Option<&'a mut MaybeUninit<Option<Box<T>>>>,
    name: &str,
) -> Result<&'a mut Option<Box<T>>, Failure> {
    Ok(given(place, name)?.write(None))
}

/// Stores the descriptor of a handle.
pub(crate) fn store_descriptor(
    handle: &impl AsFd,
    fd: Option<&mut MaybeUninit<c_int>>,
) -> Result<(), Failure> {
    given(fd, "fd")?.write(handle.as_fd().as_raw_fd());
    Ok(())
}

/// Stores the address of bytes that the library keeps, and their number. `name` is that of the argument `data`.
pub(crate) fn store_bytes<T>(
    bytes: &[u8],
    data: Option<&mut MaybeUninit<*const T>>,
    name: &str,
    len: Option<&mut MaybeUninit<usize>>,
) -> Result<(), Failure> {
    let data = given(data, name)?;
    given(len, "len")?.write(bytes.len());
    data.write(bytes.as_ptr().cast());
    Ok(())
}
