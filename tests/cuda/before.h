// What CUDA adds to C++, on this processor; included before a kernel.
#include <cmath>
#include <cstdint>
#include <cstring>
using namespace std;
#define __global__
#define __constant__
#define __launch_bounds__(threads, blocks)
static thread_local struct { unsigned x; } gridDim, blockDim, blockIdx, threadIdx;
