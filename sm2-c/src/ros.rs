//! Types of ROS 2 by their names. Programs encode and decode the messages themselves, as CDR.

use std::ffi::{CString, c_char};
use std::mem::MaybeUninit;
use std::path::Path;

use sm2_ros_idl::{Set, TypeName};

use crate::arguments::Text;
use crate::report::store_text;
use crate::status::{Failure, Status, guard};

/// Stores the schema text of a type of ROS 2 in `schema`, such as that of `sensor_msgs/msg/Image`. Free it with
/// `sm2_text_free()`.
///
/// A topic carries the type if an `sm2_type_t` has this name and this schema. Its messages are those of ROS 2 in CDR,
/// with the 4 bytes of the encapsulation in front, as `rmw_serialize()` of ROS 2 and the library Fast CDR write them.
/// The library does not look into them. Programs in Rust and Python that declare the type have the same topics. The
/// parts of a service are `std_srvs/srv/SetBool_Request` and `std_srvs/srv/SetBool_Response`.
///
/// The definitions of ROS 2's common interfaces are built in. `folder` is NULL, or a package with definitions
/// (`FOLDER/msg/NAME.msg`), or a folder of packages, such as `/opt/ros/jazzy/share`: a definition there replaces the
/// built-in one of the same name.
///
/// Errors: `SM2_BAD_NAME`; `SM2_BAD_SCHEMA` if nothing defines the type or a type that it refers to; `SM2_IO` if the
/// folder cannot be read; `SM2_MISUSE`.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_ros_schema(
    name: *const c_char,
    folder: *const c_char,
    schema: Option<&mut MaybeUninit<*mut c_char>>,
) -> Status {
    guard(|| {
        store_text(schema, "schema", || {
            let name: TypeName = Text(name).required("name")?.parse()?;
            let mut set = Set::default();
            if let Some(folder) = Text(folder).optional("folder")? {
                set.add_definitions(Path::new(folder))?;
            }
            sm2_ros::definitions::complete(&mut set, &name);
            let text = CString::new(set.schema_text(&name)?);
            text.map_err(|error| Failure::new(Status::BAD_SCHEMA, &error, None))
        })
    })
}
