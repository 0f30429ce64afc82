// What the body of a native function begins with, for one environment: types and operations on a value, after
// `typedef ... Real` and with pack and lane as its arguments. vector.h has the same for many lanes.

typedef Real Value;
typedef double Wide;
auto widen = [](Value a) -> Wide { return static_cast<Wide>(a); };
auto narrow = [](Wide a) -> Value { return static_cast<Value>(a); };
auto root = [](Value a) -> Value { return wp::sqrt(a); };
#if defined(__CUDA_ARCH__)
auto first_bit = [](int mask) -> int { return __ffs(mask) - 1; };
auto fused = [](Value a, Value b, Value c) -> Value { return fma(a, b, c); };
auto reduced = [](Value a, Value b, Value c) -> Value { return fma(-a, b, c); };
#else
auto first_bit = [](int mask) -> int { return __builtin_ctz(mask); };
auto fused = [](Value a, Value b, Value c) -> Value { return __builtin_elementwise_fma(a, b, c); };
auto reduced = [](Value a, Value b, Value c) -> Value { return __builtin_elementwise_fma(-a, b, c); };
#endif
auto quotient = [](Value a, Value b) -> Value { return a / b; };
auto any_below = [](Value a) -> bool { return a <= Real(0); };
auto each_lane = [](auto&& act) { act(0); };
auto lane_of = [](const Value& a, int) -> Real { return a; };
auto set_lane = [](Value& a, int, Real x) { a = x; };
auto weights = [&](int mask) -> Value { return Value((mask >> lane) & 1); };
auto smaller = [](Value a, Value b) -> Value { return b < a ? b : a; };
// The larger of a and |b|, which ignores NaN: one lane must not blind the others.
auto longer = [](Wide a, Wide b) -> Wide {
    a = b > a ? b : a;
    return -b > a ? -b : a;
};
auto bits_of = [](bool a) -> int { return a ? 1 : 0; };
auto least = [](Wide a) -> double { return a; };
auto largest = [](Wide a) -> double { return a; };
#if defined(__CUDA_ARCH__)
struct Values {
    Value* first;
    size_t gap;
    __device__ Value& operator[](unsigned r) const { return first[r * gap]; }
};
struct Wides {
    Wide* first;
    size_t gap;
    __device__ Wide& operator[](unsigned r) const { return first[r * gap]; }
};
auto values = [&](const wp::array_t<Real>& a) -> Values {
    return {&wp::index(a, pack, 0, lane), a.strides[1] / sizeof(Value)};
};
auto wides = [&](const wp::array_t<double>& a) -> Wides {
    return {&wp::index(a, pack, 0, lane), a.strides[1] / sizeof(Wide)};
};
auto lane_table = [&](const wp::array_t<Real>& a, int row) -> Values {
    return {&wp::index(a, row, 0, lane), a.strides[1] / sizeof(Value)};
};
#else
auto values = [&](const wp::array_t<Real>& a) -> Value* { return &wp::index(a, pack, 0, lane); };
auto wides = [&](const wp::array_t<double>& a) -> Wide* { return &wp::index(a, pack, 0, lane); };
auto lane_table = [&](const wp::array_t<Real>& a, int row) -> Value* { return &wp::index(a, row, 0, lane); };
#endif
