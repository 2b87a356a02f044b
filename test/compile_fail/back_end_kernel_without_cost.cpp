// expect: BackEnd: Outliers is GroupGnc, or a kernel with `double weight(double squared_residual) const` and
// A kernel that only weighs: the optimizer has to compare costs too.
#include "chainslam/slam/back_end.hpp"

struct MyKernel {
  double weight(double squared_residual) const { return 1.0 / (1.0 + squared_residual); }
#ifdef CHAINSLAM_RIGHT
  double cost(double squared_residual) const { return std::log1p(squared_residual); }
#endif
};

using namespace chainslam;
int main() { (void)sizeof(BackEnd<LoopCloser<>, NoChaining, NoMerging, MyKernel>); }
