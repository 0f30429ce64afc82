// What the body of the group kernel begins with, after the constants PARTS (threads of a group), POINTS and SPRINGS (capacities,
// multiples of PARTS), APPROXIMATE, and `typedef ... Real`. One environment is advanced by PARTS threads, of which this
// is number `part`. It owns the points and springs part, part + PARTS, ... and keeps what belongs to them in registers; what
// others read is in `at`, shared memory on CUDA.

// How often a group comes to a place in a sub-step, for `suite=cuda`; the place is the rest of the block.
#if TALLIED
int visits[PLACES] = {};
#define COUNT(place) ++visits[PLACE_##place]
#define TALLY(substep) tally(substep)
#else
#define COUNT(place)
#define TALLY(substep)
#endif

#if defined(__CUDA_ARCH__)
#define UNROLL _Pragma("unroll")
#define ROLL _Pragma("unroll 1")
#define EACH_POINT _Pragma("unroll POINTS_AT_ONCE")
#define EACH_SPRING _Pragma("unroll SPRINGS_AT_ONCE")
#define HIDE(number) asm volatile("" : "+r"(number))  // the compiler knows nothing about it from here on
const unsigned first_thread = (threadIdx.x & 31) / PARTS * PARTS, everyone = 0xffffffffu;
#else
#define UNROLL
#define ROLL
#define EACH_POINT
#define EACH_SPRING
#define HIDE(number)
#endif

typedef Real Value;  // as in scalar.h
static_assert(POINTS % PARTS == 0 && SPRINGS % PARTS == 0 && POINTS <= 64 * PARTS && SPRINGS < 1 << 15, "capacities");
constexpr int POINT_ROUNDS = POINTS / PARTS, SPRING_ROUNDS = SPRINGS / PARTS;
// Up to FEW rounds are unrolled; what a thread owns is in registers then, else in local memory.
constexpr int POINTS_AT_ONCE = POINT_ROUNDS <= FEW ? POINT_ROUNDS : 1;
constexpr int SPRINGS_AT_ONCE = SPRING_ROUNDS <= FEW ? SPRING_ROUNDS : 1;
constexpr int LINKS = 8;                          // springs of a point whose places are kept at hand
constexpr int QUEUE = 4 * PARTS, CLOSE = 8 * PARTS;  // room for contacts and for corners that are near another voxel

typedef float Single;  // Warp gives float(...) a meaning of its own
struct alignas(4 * sizeof(Real)) Spring {
    unsigned ends;            // the two points, 16 bits each
    Real stiffness;
    Real longest, shortest;  // squares of the lengths beyond which it is corrected
};
struct Side {
    unsigned ends;
    Real rest;  // length
};
struct alignas(16) Links { unsigned short place[LINKS]; };  // of the tensions that pull at a point
struct Hit {
    int point[3];  // the corner and the two ends of the side, -1: none
    Push push[3];
};
struct Touch {  // what the contacts of a sub-step need
    Place velocity[POINTS];  // displacement of the last sub-step / dt
    Hit hit[PARTS];
    int queue[QUEUE];
};
struct alignas(4 * sizeof(Real)) Shared {
    Place pos[POINTS];
    Pair disp[POINTS], contact[POINTS];
    Links links[POINTS];
    Spring spring[SPRINGS];
    int close[CLOSE];
    Side rigid[PARTS];  // the first of the sides of rigid voxels
    union {  // one after another in a sub-step
        Touch touch;
        Pair tension[2 * SPRINGS + 2];  // force of a spring on its first end, on its second; at last -0
        Pair moved[POINTS];             // corrections of the strain limit
    };
#if !defined(__CUDA_ARCH__)
    int turn[PARTS];  // for votes
    float path[PARTS];
#endif
};

// The groups of a warp take the same way: where one has work, all of them come along. `sync` and `some` are about the warp,
// as is `most`, the largest of numbers that the threads of a group share; `vote` gives the bits of a group.
#if defined(__CUDA_ARCH__)
static_assert(sizeof(Shared) <= GROUP_BYTES, "Group.bytes is too small");
static_assert(32 / PARTS * GROUP_BYTES <= SHARED_BYTES, "no room in shared memory");
__shared__ Shared groups[32 / PARTS];
Shared& at = groups[first_thread / PARTS];
auto sync = [&]() { __syncwarp(); };
auto vote = [&](bool yes) -> unsigned {
    const unsigned bits = __ballot_sync(everyone, yes);
    return PARTS == 32 ? bits : bits >> first_thread & ((1u << (PARTS % 32)) - 1u);
};
auto some = [&](bool yes) -> bool { return __any_sync(everyone, yes); };
auto most = [&](int a) -> int {
    for (int k = PARTS; k < 32; k *= 2) a = max(a, __shfl_xor_sync(everyone, a, k));
    return a;
};
auto count_bits = [](unsigned a) -> int { return __popc(a); };
auto lowest = [](unsigned a) -> int { return __ffs(a) - 1; };
auto largest = [&](float a) -> float {  // of a warp, not negative
#if __CUDA_ARCH__ >= 800
    return __uint_as_float(__reduce_max_sync(everyone, __float_as_uint(a)));
#else
    for (int k = 1; k < 32; k *= 2) a = fmaxf(a, __shfl_xor_sync(everyone, a, k));
    return a;
#endif
};
#else
static_assert(sizeof(Shared) <= GROUP_BYTES, "Group.bytes is too small");
Shared& at = *reinterpret_cast<Shared*>(&wp::index(scratch, pack, 0));
auto sync = [&]() { WP_TILE_SYNC(); };
auto vote = [&](bool yes) -> unsigned {
    at.turn[part] = yes;
    sync();
    unsigned bits = 0;
    for (int k = 0; k < PARTS; ++k) bits |= unsigned(at.turn[k]) << k;
    sync();
    return bits;
};
auto some = [&](bool yes) -> bool { return vote(yes) != 0; };
auto most = [](int a) -> int { return a; };
auto count_bits = [](unsigned a) -> int { return __builtin_popcount(a); };
auto lowest = [](unsigned a) -> int { return __builtin_ctz(a); };
auto largest = [&](float a) -> float {
    at.path[part] = a;
    sync();
    for (int k = 0; k < PARTS; ++k) a = at.path[k] > a ? at.path[k] : a;
    sync();
    return a;
};
#endif

// The sum of the numbers below 2^16 that the threads before this one have; `total`: of all threads.
auto sum_before = [&](unsigned number, int& total) -> int {
    int before = 0;
    total = 0;
    ROLL for (int b = 0; b < 16; ++b) {
        const unsigned those = vote(number >> b & 1);
        before += count_bits(those & ((1u << part) - 1)) << b;
        total += count_bits(those) << b;
    }
    return before;
};

// Square root, its inverse and quotients of the springs. Approximate, they are accurate to 2 units in the last place.
#if defined(__CUDA_ARCH__) && APPROXIMATE
auto inverse_root = [](float a) -> float {
    float r;
    asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
    return r;
};
auto inverse = [](float a) -> float {
    float r;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
    return r;
};
auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
auto reduced = [](float a, float b, float c) -> float { return __fmaf_rn(-a, b, c); };
auto fused_wide = [](double a, double b, double c) -> double { return __fma_rn(a, b, c); };
#elif APPROXIMATE
auto inverse_root = [](float a) -> float { return 1.0f / __builtin_sqrtf(a); };
auto inverse = [](float a) -> float { return 1.0f / a; };
auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
auto reduced = [](float a, float b, float c) -> float { return __builtin_fmaf(-a, b, c); };
auto fused_wide = [](double a, double b, double c) -> double { return __builtin_fma(a, b, c); };
#else
auto fused = [](Real a, Real b, Real c) -> Real { return a * b + c; };
auto reduced = [](Real a, Real b, Real c) -> Real { return c - a * b; };
auto root = [](Real a) -> Real { return wp::sqrt(a); };
auto quotient = [](Real a, Real b) -> Real { return a / b; };
#endif
#if APPROXIMATE
auto root = [&](float a) -> float { return a * inverse_root(a); };
auto quotient = [&](float a, float b) -> float { return a * inverse(b); };
#endif

auto tanh_of = [](double a) -> double {
#if APPROXIMATE
    return double(wp::tanh(Single(a)));
#else
    return wp::tanh(a);
#endif
};

#if TALLIED
auto tally = [&](int substep) {  // of its threads the most
    int* all = reinterpret_cast<int*>(&wp::index(scratch, pack, 0)) + GROUP_BYTES / sizeof(int);
    for (int k = 0; k < PLACES; ++k) {
        const int most = static_cast<int>(largest(Single(visits[k])));
        if (part == 0) all[substep * PLACES + k] = most;
        visits[k] = 0;
    }
};
#endif
