// error: fields are left out or not in their order
#include "sm2/sm2.hpp"
struct Pair {
    double one, two;
};
SM2_STRUCT(Pair, "test/Pair", two, one);
int main() {}
