// The messages of the examples.
#ifndef SCAN_HPP
#define SCAN_HPP

#include "sm2/sm2.hpp"

namespace demo {

struct Scan {
    std::uint64_t stamp_ns;
    std::array<float, 360> ranges_m;
};

}  // namespace demo

SM2_STRUCT(demo::Scan, "demo/Scan", stamp_ns, ranges_m);

#endif
