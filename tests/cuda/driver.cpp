// A CUDA driver whose device is this processor: kernels are shared libraries, and threads run one after the other.
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>
#include <set>
#include <unistd.h>

extern "C" {
int version = 12080, devices = 1, capability = 90;
char failing[64];  // function that returns `status`
int status;
int64_t launches, blocks;

static std::set<void *> allocated;

int64_t in_use() { return (int64_t)allocated.size(); }

#define CALL(name) if (!strcmp(failing, name)) return status

int cuInit(unsigned) { CALL("cuInit"); return 0; }
int cuDriverGetVersion(int *found) { *found = version; return 0; }
int cuDeviceGetCount(int *found) { *found = devices; return 0; }
int cuDeviceGet(int *device, int number) { *device = number; return 0; }
int cuDeviceGetName(char *name, int size, int) { strncpy(name, "this processor", size); return 0; }
int cuDeviceGetAttribute(int *found, int which, int) { *found = which == 75 ? capability / 10 : capability % 10; return 0; }
int cuDevicePrimaryCtxRetain(void **context, int) { *context = (void *)1; return 0; }
int cuCtxSetCurrent(void *context) { return context == (void *)1 ? 0 : 201; }
int cuCtxSynchronize() { CALL("cuCtxSynchronize"); return 0; }
int cuGetErrorName(int, const char **name) { *name = "CUDA_ERROR_OF_TESTS"; return 0; }

int cuModuleLoadData(void **module, const void *image)
{
    CALL("cuModuleLoadData");
    char path[] = "/tmp/mckibben-kernel-XXXXXX";
    int file = mkstemp(path);
    const int64_t size = *(const int64_t *)image;  // a length, and a shared library
    bool written = write(file, (const char *)image + 8, size) == size;
    close(file);
    *module = written ? dlopen(path, RTLD_NOW | RTLD_LOCAL) : nullptr;
    unlink(path);
    return *module ? 0 : 200;
}

int cuModuleGetFunction(void **function, void *module, const char *name)
{
    *function = dlsym(module, strcmp(name, "run") ? "launch_prepare" : "launch_run");
    return *function ? 0 : 500;
}

int cuModuleGetGlobal_v2(int64_t *place, size_t *size, void *module, const char *name)
{
    *place = (int64_t)dlsym(module, name);
    *size = *(size_t *)dlsym(module, "known_size");
    return *place ? 0 : 500;
}

int cuMemAlloc_v2(int64_t *place, size_t size)
{
    CALL("cuMemAlloc_v2");
    void *found = size ? malloc(size) : nullptr;
    allocated.insert(found);
    *place = (int64_t)found;
    return found ? 0 : 1;
}

int cuMemFree_v2(int64_t place)
{
    free((void *)place);
    return allocated.erase((void *)place) ? 0 : 1;
}

int cuMemcpyHtoD_v2(int64_t to, const void *from, size_t size) { memcpy((void *)to, from, size); return 0; }
int cuMemcpyDtoD_v2(int64_t to, int64_t from, size_t size) { memcpy((void *)to, (void *)from, size); return 0; }
int cuMemcpyDtoH_v2(void *to, int64_t from, size_t size) { memcpy(to, (void *)from, size); return 0; }

int cuLaunchKernel(void *function, unsigned x, unsigned, unsigned, unsigned threads, unsigned, unsigned, unsigned, void *,
                   void **arguments, void **)
{
    CALL("cuLaunchKernel");
    ++launches;
    blocks += x;
    ((void (*)(unsigned, unsigned, void **))function)(x, threads, arguments);
    return 0;
}
}
