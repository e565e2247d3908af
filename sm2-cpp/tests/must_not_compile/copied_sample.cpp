// error: deleted
#include "sm2/sm2.hpp"
sm2::Sample<double> copy(const sm2::Sample<double>& sample) { return sample; }
int main() {}
