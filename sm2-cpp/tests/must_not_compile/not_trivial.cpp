// error: is not trivially copyable
#include "sm2/sm2.hpp"
struct Owner {
    double value;
    Owner(const Owner&) {}
};
SM2_STRUCT(Owner, "test/Owner", value);
int main() {}
