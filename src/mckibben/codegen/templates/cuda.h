typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
#define INFINITY __longlong_as_double(0x7ff0000000000000ll)
#define NAN __longlong_as_double(0x7ff8000000000000ll)
