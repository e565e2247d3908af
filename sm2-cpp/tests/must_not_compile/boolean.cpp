// error: cannot be a bool
#include "sm2/sm2.hpp"
struct Brake {
    bool engaged;
};
SM2_STRUCT(Brake, "test/Brake", engaged);
int main() { return sm2::Message<Brake>::schema().empty(); }
