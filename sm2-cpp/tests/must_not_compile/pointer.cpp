// error: a field of a message is a number, an array, or a struct
#include "sm2/sm2.hpp"
struct List {
    double* values;
};
SM2_STRUCT(List, "test/List", values);
int main() { return sm2::Message<List>::schema().empty(); }
