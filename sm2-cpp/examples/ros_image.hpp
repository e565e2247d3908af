// An image of ROS 2 and its CDR, which the library Fast CDR writes and reads.
#ifndef ROS_IMAGE_HPP
#define ROS_IMAGE_HPP

#include <string>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastcdr/config.h>

#include "sm2/sm2.hpp"

namespace demo {

// The fields of sensor_msgs/msg/Image in their order.
struct Image {
    std::int32_t sec = 0;
    std::uint32_t nanosec = 0;
    std::string frame_id;
    std::uint32_t height = 0;
    std::uint32_t width = 0;
    std::string encoding;
    std::uint8_t is_bigendian = 0;
    std::uint32_t step = 0;
    std::vector<std::uint8_t> data;
};

// The encoding of ROS 2.
inline eprosima::fastcdr::Cdr cdr_of(eprosima::fastcdr::FastBuffer& buffer) {
    using eprosima::fastcdr::Cdr;
#if FASTCDR_VERSION_MAJOR > 1
    return Cdr(buffer, Cdr::DEFAULT_ENDIAN, eprosima::fastcdr::CdrVersion::XCDRv1);
#else
    return Cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
#endif
}

// Writes an image to the buffer, which grows. Returns the bytes there.
inline sm2::span<const std::byte> encode(const Image& image,
                                         eprosima::fastcdr::FastBuffer& buffer) {
    auto cdr = cdr_of(buffer);
    cdr.serialize_encapsulation();
    cdr << image.sec << image.nanosec << image.frame_id << image.height << image.width
        << image.encoding << image.is_bigendian << image.step << image.data;
#if FASTCDR_VERSION_MAJOR > 1
    const std::size_t len = cdr.get_serialized_data_length();
#else
    const std::size_t len = cdr.getSerializedDataLength();
#endif
    return {reinterpret_cast<const std::byte*>(buffer.getBuffer()), len};
}

// Reads an image. Throws a std::exception if the bytes are none.
inline Image decode(sm2::span<const std::byte> bytes) {
    // The buffer is only read.
    auto* const first = const_cast<char*>(reinterpret_cast<const char*>(bytes.data()));
    eprosima::fastcdr::FastBuffer buffer(first, bytes.size());
    auto cdr = cdr_of(buffer);
    Image image;
    cdr.read_encapsulation();
    cdr >> image.sec >> image.nanosec >> image.frame_id >> image.height >> image.width >>
        image.encoding >> image.is_bigendian >> image.step >> image.data;
    return image;
}

}  // namespace demo

SM2_ROS_TYPE(demo::Image, "sensor_msgs/msg/Image");

#endif
