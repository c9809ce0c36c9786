// The threads of a kernel, one after the other; included after it.
extern "C" const size_t known_size = sizeof known;
#define LAUNCH(kernel) \
    extern "C" void launch_##kernel(unsigned blocks, unsigned threads, void **arguments) \
    { \
        gridDim.x = blocks; \
        blockDim.x = threads; \
        for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x) \
            for (threadIdx.x = 0; threadIdx.x < threads; ++threadIdx.x) \
                kernel(*(Scalars *)arguments[0], *(double **)arguments[1], *(double **)arguments[2], *(int64_t *)arguments[3]); \
    }
LAUNCH(prepare)
LAUNCH(run)
