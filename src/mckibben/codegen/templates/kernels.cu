/* Numbers of all runs are parameters of the kernels, which take no registers. */
struct Scalars { double x[${scalars or 1}]; };
__constant__ ${real} known[${(constants | length) or 1}];
extern "C" __global__ void prepare
(const Scalars given, const double *__restrict__ arrays, double *__restrict__ results, int64_t lanes)
{
    const double *scalars = given.x;
${places | join("\n")}
${prepared | join("\n")}
<% for text in constants %>
        ((${real} *)results)[${loop.index0}] = ${text};
<% endfor %>
}
extern "C" __global__ void __launch_bounds__(${threads}, ${blocks}) run
(const Scalars given, const double *__restrict__ arrays, double *__restrict__ results, int64_t lanes)
{
    const double *scalars = given.x;
${places | join("\n")}
    for (int64_t b = blockIdx.x * (int64_t)blockDim.x + threadIdx.x; b < lanes; b += (int64_t)gridDim.x * blockDim.x) {
${body | join("\n")}
    }
}
