// What the body of a native function begins with, for WIDTH lanes: types and operations on a value, after
// `typedef ... Real` and with pack and lane as its arguments. Values are vectors of the compiler, which stay in registers.

typedef Real Value __attribute__((ext_vector_type(WIDTH), aligned(8)));
typedef double Wide __attribute__((ext_vector_type(WIDTH), aligned(8)));
auto widen = [](Value a) -> Wide { return __builtin_convertvector(a, Wide); };
auto narrow = [](Wide a) -> Value { return __builtin_convertvector(a, Value); };
auto root = [](Value a) -> Value { return __builtin_elementwise_sqrt(a); };
auto each_lane = [](auto&& act) { for (int k = 0; k < WIDTH; ++k) act(k); };
auto lane_of = [](const Value& a, int k) -> Real { return a[k]; };
auto set_lane = [](Value& a, int k, Real x) { a[k] = x; };
auto weights = [&](int mask) -> Value {  // 1 in the lanes of a mask, else 0
    typedef bool Bits __attribute__((ext_vector_type(WIDTH)));
    Bits bits;
    __builtin_memcpy(&bits, &mask, WIDTH / 8);
    return __builtin_convertvector(bits, Value);
};
auto smaller = [](Value a, Value b) -> Value { return b < a ? b : a; };
// The larger of a and |b|, which ignores NaN: one lane must not blind the others.
auto longer = [](Wide a, Wide b) -> Wide {
    a = b > a ? b : a;
    return -b > a ? -b : a;
};
// One of all lanes but NaN, from halves: the compiler's own way is one lane after another.
auto halve = [](auto self, auto a, auto choose) -> double {
    if constexpr (sizeof(a) == sizeof(double)) {
        return a;
    } else {
        return self(self, choose(a.lo, a.hi), choose);
    }
};
auto least = [&](Wide a) -> double { return halve(halve, a, [](auto b, auto c) { return ((b < c) | (c != c)) ? b : c; }); };
auto largest = [&](Wide a) -> double { return halve(halve, a, [](auto b, auto c) { return ((b > c) | (c != c)) ? b : c; }); };
auto bits_of = [](auto a) -> int {
    typedef bool Bits __attribute__((ext_vector_type(WIDTH)));
    const Bits bits = __builtin_convertvector(a, Bits);
    unsigned mask = 0;
    __builtin_memcpy(&mask, &bits, WIDTH / 8);
    return static_cast<int>(mask);
};
auto first_bit = [](int mask) -> int { return __builtin_ctz(mask); };
auto fused = [](Value a, Value b, Value c) -> Value { return __builtin_elementwise_fma(a, b, c); };
auto reduced = [](Value a, Value b, Value c) -> Value { return __builtin_elementwise_fma(-a, b, c); };
auto quotient = [](Value a, Value b) -> Value { return a / b; };
auto any_below = [&](Value a) -> bool { return bits_of(a <= Real(0)); };
auto values = [&](const wp::array_t<Real>& a) { return reinterpret_cast<Value*>(&wp::index(a, pack, 0, lane)); };
auto wides = [&](const wp::array_t<double>& a) { return reinterpret_cast<Wide*>(&wp::index(a, pack, 0, lane)); };
// A table of the Model that differs from lane to lane.
auto lane_table = [&](const wp::array_t<Real>& a, int row) { return reinterpret_cast<Value*>(&wp::index(a, row, 0, lane)); };
