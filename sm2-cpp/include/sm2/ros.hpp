// Types of ROS 2 by their names. A message is its CDR encoding, which the program writes and reads.
#ifndef SM2_ROS_HPP
#define SM2_ROS_HPP

#include "sm2/message.hpp"

namespace sm2::detail {

// The type of this name, by the built-in definitions and those in `folder`.
inline DeclaredType ros_type(const std::string& name, const std::string& folder = {}) {
    const char* const searched = folder.empty() ? nullptr : folder.c_str();
    return DeclaredType(
        name, text([&](char** schema) { return sm2_ros_schema(name.c_str(), searched, schema); }));
}

}  // namespace sm2::detail

// Makes `Type` stand for a type of ROS 2, outside of all namespaces:
// SM2_ROS_TYPE(robot::Image, "sensor_msgs/msg/Image"). `Type` may be a class that is only declared, or that of another
// library for this message. Its publishers and subscribers use bytes (span<const std::byte>): CDR, with the 4 bytes of
// the encapsulation in front, as the library Fast CDR writes it. Programs in Rust and Python that declare the type have
// the same topics.
//
// The definitions of ROS 2's common interfaces are built in. A third argument names a package with definitions, or a
// folder of packages: SM2_ROS_TYPE(robot::Wheel, "my_msgs/msg/Wheel", "/opt/robot/share"). The first use of a type that
// nothing defines throws SM2_BAD_SCHEMA.
#define SM2_ROS_TYPE(Type, ...)                                                                    \
    template <>                                                                                    \
    struct sm2::Message<Type> : sm2::Message<std::byte[]> {                                        \
        static const sm2_type_t* type() {                                                          \
            static const sm2::detail::DeclaredType type = sm2::detail::ros_type(__VA_ARGS__);      \
            return type.get();                                                                     \
        }                                                                                          \
    }

#endif
