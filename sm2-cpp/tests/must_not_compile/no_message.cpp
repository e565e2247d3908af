// error: T is not a message
#include "sm2/sm2.hpp"
struct Unknown {
    double value;
};
void declare(const sm2::Node& node) { (void)node.publisher<Unknown>("topic"); }
int main() {}
