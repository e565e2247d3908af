// error: has padding
#include "sm2/sm2.hpp"
struct Padded {
    std::uint8_t state;
    double value;
};
SM2_STRUCT(Padded, "test/Padded", state, value);
int main() {}
