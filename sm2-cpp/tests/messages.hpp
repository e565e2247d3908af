// The messages of the tests. tests/peer.rs of sm2-c has the same in Rust.
#ifndef MESSAGES_HPP
#define MESSAGES_HPP

#include "sm2/sm2.hpp"

namespace robot {

struct Vector {
    double x, y, z;
};

struct Imu {
    std::uint64_t stamp_ns;
    Vector acceleration;
    std::array<float, 4> orientation;
    std::int16_t temperature[3];
    std::uint8_t state;
    std::uint8_t padding;
};

}  // namespace robot

SM2_STRUCT(robot::Vector, "robot/Vector", x, y, z);
SM2_STRUCT(robot::Imu, "robot/Imu", stamp_ns, acceleration, orientation, temperature, state, padding);

#endif
