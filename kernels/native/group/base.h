// What the body of the group kernel begins with, after the constants PARTS (threads of a group), POINTS, MOVERS, SPRINGS and
// RIGIDS (capacities, multiples of 16 or 32; points from MOVERS on neither move nor hang on a spring; sides of rigid voxels),
// APPROXIMATE, and `typedef ... Real`. One environment is advanced by PARTS threads, of which this is number `part`. It owns the points below MOVERS and
// the springs part, part + PARTS, ... and keeps what belongs to them in registers; what others read is in `at`, shared
// memory on CUDA.

#if defined(__CUDA_ARCH__)
constexpr bool TIGHT = true;  // POINTS and SPRINGS are the sizes of the tables, rounded up
#define UNROLL _Pragma("unroll")
#define ROLL _Pragma("unroll 1")
#define EACH_POINT _Pragma("unroll POINTS_AT_ONCE")
#define EACH_SPRING _Pragma("unroll SPRINGS_AT_ONCE")
#define KEEP(number) asm("" : "+r"(number))  // computed as it stands
#define HIDE(number) asm volatile("" : "+r"(number))  // the compiler knows nothing about it from here on
#define GLOBAL(pointer) __builtin_assume(__isGlobal(pointer))  // loads need not ask in which memory it points
const unsigned first_thread = PARTS > 32 ? 0 : (threadIdx.x & 31) / PARTS * PARTS, everyone = 0xffffffffu;
#else
constexpr bool TIGHT = false;
#define UNROLL
#define ROLL
#define EACH_POINT
#define EACH_SPRING
#define KEEP(number)
#define HIDE(number)
#define GLOBAL(pointer)
#endif

typedef Real Value;  // as in scalar.h
typedef double Wide;
auto widen = [](Value a) -> Wide { return a; };
auto narrow = [](Wide a) -> Value { return Value(a); };
// Where several warps have an environment, the last of them may have nothing in the last round of points or springs.
constexpr int WARPS = PARTS > 32 ? PARTS / 32 : 1, WHOLE = PARTS > 32 ? 32 : PARTS;
static_assert(POINTS % WHOLE == 0 && MOVERS % WHOLE == 0 && SPRINGS % WHOLE == 0, "capacities");
static_assert(MOVERS <= 64 * PARTS && MOVERS <= 1 << 14 && SPRINGS < 1 << 15, "capacities");
constexpr int POINT_ROUNDS = (MOVERS + PARTS - 1) / PARTS, SPRING_ROUNDS = (SPRINGS + PARTS - 1) / PARTS;
auto within = [&](int j, int capacity) -> bool { return capacity % PARTS == 0 || part + PARTS * j < capacity; };
// Up to FEW rounds are unrolled; what a thread owns is in registers then, else in local memory.
constexpr int POINTS_AT_ONCE = POINT_ROUNDS <= FEW ? POINT_ROUNDS : 1;
constexpr int SPRINGS_AT_ONCE = SPRING_ROUNDS <= FEW ? SPRING_ROUNDS : 1;
constexpr int ROUNDS_A_BIT = (SPRING_ROUNDS + 31) / 32;  // of springs, in a set of rounds
constexpr unsigned FREE = 1u << 15, LAST = 1u << 14, POINT = LAST - 1;  // of the ends of a Side
constexpr int QUEUE = 4 * PARTS;                         // room for contacts

typedef float Single;  // Warp gives float(...) a meaning of its own
struct alignas(2 * sizeof(Real)) Spring {
    unsigned ends;  // places of the two displacements, 16 bits each
    Real stiffness;
};
struct alignas(2 * sizeof(Real)) Length {
    Real goal;    // to which it relaxes
    Real middle;  // of the squares of the lengths within which it is not corrected
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
struct alignas(16) Tables {  // looked up in every sub-step; registers are not kept for them
    const wp::vec_t<4, int>* corner;
    wp::vec_t<4, int>* candidates;
    const double* terrain_box;  // left, right, bottom and top of each cell
    int frame;
};
struct Touch {  // what the contacts of a sub-step need
    Place velocity[MOVERS];  // displacement of the last sub-step / dt
    Hit hit[WHOLE];
    int queue[QUEUE];
};
struct alignas(16) Shared {
    Place pos[POINTS];
    Pair disp[MOVERS], contact[MOVERS];
    Links links[MOVERS];
    Spring spring[SPRINGS];
    Length length[SPRINGS];  // elements of 8 bytes: half a warp reads as many words as there are banks
    Side rigid[RIGIDS];      // sides of rigid voxels
    Tables tables;
    union {  // one after another in a sub-step
        Touch touch;
        Pair tension[2 + SPRINGS];  // 0 and -0, then force of a spring on its first end
        Pair moved[MOVERS];         // corrections of the strain limit
    };
    unsigned short close[CLOSE];  // corners that are near another voxel
};
static_assert(sizeof(Shared) == GROUP_BYTES, "Group.layout is another");

// The groups of a warp, or the warps of a group, are a block and take the same way: where one has work, all of them come
// along. `sync` and `some` are about the block, as is `most`, the largest of numbers that the threads of a group share.
// `first_of` gives the first thread of a group that says yes (PARTS: none), `rank_of` how many before this one do, and
// how many in all; both whether the block has `any`; `sum_before` the sum of the numbers below 2^16 that the threads
// before this one have, and the `total` of the group. None of them stands where the block may go different ways. The first
// warp may be alone at `sync_first_warp`, `some_of_warp` and `first_of_warp` (WHOLE: none).
#if defined(__CUDA_ARCH__)
constexpr int GROUPS = PARTS < 32 ? 32 / PARTS : 1;
#if LARGE
Shared* const groups = reinterpret_cast<Shared*>(room.data.ptr);
#else
static_assert(GROUPS * GROUP_BYTES <= SHARED_BYTES, "no room in shared memory");
__shared__ Shared groups[GROUPS];
#endif
Shared& at = groups[first_thread / PARTS];
// Where an element of `disp` or `tension` is, in 16 bits: in bytes, so that nothing is left to compute, or where these are
// too many in units of 8; the next is STEP further. ADDED is a bit that no place has.
constexpr unsigned UNIT = GROUPS * GROUP_BYTES < 1 << 16 ? 1 : 8, STEP = sizeof(Pair) / UNIT;
constexpr unsigned ADDED = UNIT == 1 ? 1 : 1u << 15;
char* const memory = reinterpret_cast<char*>(groups);
auto place_of = [&](const Pair* pairs, int n) -> unsigned {
    return unsigned(reinterpret_cast<const char*>(pairs + n) - memory) / UNIT;
};
auto pair_at = [&](const Pair*, unsigned place) -> Pair { return *reinterpret_cast<const Pair*>(memory + UNIT * place); };
constexpr int WIDER = UNIT * sizeof(Place) / sizeof(Pair);
const int before_pos = reinterpret_cast<char*>(at.pos) - memory - WIDER * place_of(at.disp, 0);
auto pos_at = [&](unsigned place) -> Place {  // of the point whose displacement is there
    const int begin = WIDER * place + before_pos;
    return *reinterpret_cast<const Place*>(memory + begin);
};
auto sync = [&]() { WARPS > 1 ? __syncthreads() : __syncwarp(); };
auto sync_first_warp = []() { __syncwarp(); };
auto fence = []() { __syncwarp(); };  // keeps the compiler from reading ahead, which takes registers
auto vote = [&](bool yes, bool& any) -> unsigned {  // bits of the group, of several warps of this one
    const unsigned bits = __ballot_sync(everyone, yes);
    any = bits != 0;
    return PARTS >= 32 ? bits : bits >> first_thread & ((1u << (PARTS % 32)) - 1u);
};
auto some = [&](bool yes) -> bool { return WARPS > 1 ? __syncthreads_or(yes) : __any_sync(everyone, yes); };
__shared__ unsigned said[WARPS];
auto join_warps = [&](unsigned a, auto&& act) -> unsigned {  // what the warps of a group have, in their order
    if (WARPS == 1) return a;
    if (part % 32 == 0) said[part / 32] = a;
    __syncthreads();
    unsigned joined = said[0];
    for (int k = 1; k < WARPS; ++k) joined = act(joined, said[k]);
    __syncthreads();
    return joined;
};
auto most = [&](int a) -> int {
#if __CUDA_ARCH__ >= 800
    return PARTS < 32 ? __reduce_max_sync(everyone, a) : a;
#else
    for (int k = PARTS; k < 32; k *= 2) a = max(a, __shfl_xor_sync(everyone, a, k));
    return a;
#endif
};
auto lower = [](Real a, Real b) -> Real { return fmin(a, b); };
auto higher = [](Single a, Single b) -> Single { return fmax(a, b); };
auto count_bits = [](unsigned a) -> int { return __popc(a); };
auto set_bits = [](int* word, int bits) { atomicOr(word, bits); };  // whichever thread comes first
auto lowest = [](unsigned a) -> int { return __ffs(a) - 1; };
auto sign_of = [](double a) -> int { return __double2hiint(a); };  // of a number that is a difference, never -0
auto either = [](unsigned a, unsigned b) -> unsigned { return a | b; };
auto larger = [](unsigned a, unsigned b) -> unsigned { return max(a, b); };
auto smaller = [](unsigned a, unsigned b) -> unsigned { return min(a, b); };
auto together = [&](unsigned a) -> unsigned {  // the bits that some thread of the block has
#if __CUDA_ARCH__ >= 800
    a = __reduce_or_sync(everyone, a);
#else
    for (int k = 1; k < 32; k *= 2) a |= __shfl_xor_sync(everyone, a, k);
#endif
    return join_warps(a, either);
};
auto largest = [&](float number) -> float {  // of a block, not negative: the bits are in the order of the numbers
    unsigned a = __float_as_uint(number);
#if __CUDA_ARCH__ >= 800
    a = __reduce_max_sync(everyone, a);
#else
    for (int k = 1; k < 32; k *= 2) a = max(a, __shfl_xor_sync(everyone, a, k));
#endif
    return __uint_as_float(join_warps(a, larger));
};
auto some_of_group = [&](bool yes) -> bool {
    bool any;
    return WARPS > 1 ? some(yes) : vote(yes, any) != 0;
};
auto lower_threads = [&]() -> unsigned { return (1u << (WARPS > 1 ? part % 32 : part)) - 1; };
auto add_warps = [&](int& before, int& total) {  // to what is known of this warp
    if (WARPS == 1) return;
    int k = 0, others = 0;
    total = join_warps(total, [&](unsigned a, unsigned b) -> unsigned {
        if (++k == part / 32) others = a;
        return a + b;
    });
    before += others;
};
auto rank_of = [&](bool yes, int& total, bool& any) -> int {
    const unsigned bits = vote(yes, any);
    int before = count_bits(bits & lower_threads());
    total = count_bits(bits);
    add_warps(before, total);
    if (WARPS > 1) any = total != 0;
    return before;
};
auto some_of_warp = [&](bool yes) -> bool { return __any_sync(everyone, yes); };
auto first_of_warp = [&](bool yes) -> int {
    bool any;
    const unsigned bits = vote(yes, any);
    return bits ? lowest(bits) : WHOLE;
};
auto first_of = [&](bool yes, bool& any) -> int {
    const unsigned bits = vote(yes, any);
    if (WARPS == 1) return bits ? lowest(bits) : PARTS;
    const int first = join_warps(bits ? part / 32 * 32 + lowest(bits) : PARTS, smaller);
    any = first < PARTS;
    return first;
};
auto sum_before = [&](unsigned number, int& total) -> int {
    int before = 0;
    total = 0;
    ROLL for (int b = 0; b < 16; ++b) {
        bool any;
        const unsigned those = vote(number >> b & 1, any);
        before += count_bits(those & lower_threads()) << b;
        total += count_bits(those) << b;
    }
    add_warps(before, total);
    return before;
};
#else
// A group is alone; with WHOLE_WARPS, those of a warp are a block and go the same way, as on CUDA.
constexpr int GROUPS = WHOLE_WARPS && PARTS < 32 ? 32 / PARTS : 1;
Shared& at = *reinterpret_cast<Shared*>(&wp::index(scratch, pack, 0));
constexpr unsigned STEP = 1, ADDED = 1u << 15;
auto place_of = [](const Pair*, int n) -> unsigned { return n; };
auto pair_at = [](const Pair* pairs, unsigned place) -> Pair { return pairs[place]; };
auto pos_at = [&](unsigned place) -> Place { return at.pos[place]; };
// Behind the memory of a group is what its threads vote with.
int* const turn = reinterpret_cast<int*>(reinterpret_cast<Shared*>(&wp::index(scratch, pack - pack % GROUPS, 0)) + 1);
const int first_thread = pack % GROUPS * PARTS;
auto sync = [&]() { WP_TILE_SYNC(); };
auto sync_first_warp = sync;
auto fence = [&]() {
    if (WHOLE_WARPS && PARTS <= 32) sync();
};
// Joins what threads of the block have, of the group alone where `own`.
auto join = [&](int a, bool own, auto&& act) -> int {
    turn[first_thread + part] = a;
    sync();
    int joined = turn[own ? first_thread : 0];
    for (int k = 1; k < (own ? PARTS : PARTS * GROUPS); ++k) joined = act(joined, turn[(own ? first_thread : 0) + k]);
    sync();
    return joined;
};
auto either = [](int a, int b) { return a | b; };
auto larger = [](int a, int b) { return a > b ? a : b; };
auto together = [&](unsigned a) -> unsigned { return join(a, false, either); };
auto some = [&](bool yes) -> bool { return together(yes) != 0; };
auto some_of_group = [&](bool yes) -> bool { return join(yes, true, either) != 0; };
auto smaller = [](int a, int b) { return a < b ? a : b; };
auto first_of = [&](bool yes, bool& any) -> int {
    any = some(yes);
    return join(yes ? part : PARTS, true, smaller);
};
auto some_of_warp = some;
auto first_of_warp = [&](bool yes) -> int { return join(yes && part < WHOLE ? part : WHOLE, true, smaller); };
auto sum_before = [&](unsigned number, int& total) -> int {
    int before = 0, k = 0;
    total = join(number, true, [&](int a, int b) {
        if (++k == part) before = a;
        return a + b;
    });
    return before;
};
auto rank_of = [&](bool yes, int& total, bool& any) -> int {
    any = some(yes);
    return sum_before(yes, total);
};
auto most = [&](int a) -> int { return GROUPS > 1 ? join(a, false, larger) : a; };
// One of two numbers; the other where one is not a number.
auto lower = [](Real a, Real b) -> Real { return a < b || b != b ? a : b; };
auto higher = [](Single a, Single b) -> Single { return a > b || b != b ? a : b; };
auto count_bits = [](unsigned a) -> int { return __builtin_popcount(a); };
auto set_bits = [](int* word, int bits) { __atomic_fetch_or(word, bits, __ATOMIC_RELAXED); };
auto lowest = [](unsigned a) -> int { return __builtin_ctz(a); };
auto sign_of = [](double a) -> int { return (a > 0.0) - (a < 0.0); };
auto largest = [&](float a) -> float {  // the bits of numbers that are not negative are in their order
    int bits;
    __builtin_memcpy(&bits, &a, sizeof bits);
    bits = join(bits, false, larger);
    __builtin_memcpy(&a, &bits, sizeof bits);
    return a;
};
#endif

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
auto nearest_root = [&](float a) -> float {  // rounded to nearest, of numbers that are neither 0 nor special
    const float r = inverse_root(a), s = a * r;
    return __fmaf_rn(__fmaf_rn(-s, s, a), 0.5f * r, s);
};
auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
auto reduced = [](float a, float b, float c) -> float { return __fmaf_rn(-a, b, c); };
auto fused_wide = [](double a, double b, double c) -> double { return __fma_rn(a, b, c); };
#elif APPROXIMATE
// As far off as the fast operations of CUDA may be: a unit in the last place, by the last bits of the argument.
auto off_by_a_unit = [](float a, float exact) -> float {
    unsigned bits, last;
    __builtin_memcpy(&bits, &exact, sizeof bits);
    __builtin_memcpy(&last, &a, sizeof last);
    bits += (last & 3) == 1 ? 1u : (last & 3) == 2 ? -1u : 0u;
    __builtin_memcpy(&exact, &bits, sizeof bits);
    return exact;
};
auto inverse_root = [&](float a) -> float { return off_by_a_unit(a, 1.0f / __builtin_sqrtf(a)); };
auto inverse = [&](float a) -> float { return off_by_a_unit(a, 1.0f / a); };
auto nearest_root = [](float a) -> float { return __builtin_sqrtf(a); };
auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
auto reduced = [](float a, float b, float c) -> float { return __builtin_fmaf(-a, b, c); };
auto fused_wide = [](double a, double b, double c) -> double { return __builtin_fma(a, b, c); };
#else
#if defined(__CUDA_ARCH__)
auto fused = [](Real a, Real b, Real c) -> Real { return fma(a, b, c); };
auto reduced = [](Real a, Real b, Real c) -> Real { return fma(-a, b, c); };
#else
auto fused = [](Real a, Real b, Real c) -> Real { return __builtin_elementwise_fma(a, b, c); };
auto reduced = [](Real a, Real b, Real c) -> Real { return __builtin_elementwise_fma(-a, b, c); };
#endif
auto root = [](Real a) -> Real { return wp::sqrt(a); };
auto nearest_root = root;
auto quotient = [](Real a, Real b) -> Real { return a / b; };
#endif
auto bits_of = [](bool a) -> int { return a; };
#if APPROXIMATE
auto root = [&](float a) -> float { return a * inverse_root(a); };
auto quotient = [&](float a, float b) -> float { return a * inverse(b); };
#endif
