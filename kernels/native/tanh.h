// Hyperbolic tangent in float64, of a number or of many lanes, after `typedef ... Real`. It is made of what rounds alike on
// every machine, so that the bits of a trajectory do not depend on the C library: they are those of glibc 2.36 to 2.43 on a
// CPU with fused multiply-adds, hence the release's own there. Method and constants: fdlibm (s_tanh.c, s_expm1.c).

#if APPROXIMATE
auto tanh_of = [](auto a) { return decltype(a)(wp::tanh(Single(a))); };
#else
#if defined(__CUDA_ARCH__)
auto fused_add = [](double a, double b, double c) -> double { return __fma_rn(a, b, c); };
auto truncated = [](double a) -> double { return trunc(a); };
auto power_of_two = [](double k) -> double {
    return __longlong_as_double(__double_as_longlong(k + (0x1.8p52 + 1023.0)) << 52);
};
#else
auto fused_add = [](auto a, auto b, auto c) { return __builtin_elementwise_fma(a, decltype(a)(b), decltype(a)(c)); };
auto truncated = [](auto a) { return __builtin_elementwise_trunc(a); };
auto power_of_two = [](auto k) {
    k += 0x1.8p52 + 1023.0;  // the last bits of the sum are the exponent
    auto shift = [](auto number, auto bits) {
        __builtin_memcpy(&bits, &number, sizeof bits);
        bits <<= 52;
        __builtin_memcpy(&number, &bits, sizeof bits);
        return number;
    };
    if constexpr (sizeof k == sizeof(double)) {
        return shift(k, 0ull);
    } else {
        typedef unsigned long long Words __attribute__((ext_vector_type(sizeof k / sizeof(double))));
        return shift(k, Words{});
    }
};
#endif
auto tanh_of = [&](auto a) {
    typedef decltype(a) Number;
    const Number size = a < 0.0 ? -a : a;
    // exp(u) - 1 of u = 2 |a|, or of -2 |a| where |a| < 1: u = k ln 2 + r + c, where k is -3 to 0 or 3 to 63, by the leading
    // digits of ln 2 up to 3/2 ln 2.
    const Number u = size >= 1.0 ? size + size : -size - size;
    Number k = truncated(u * 0x1.71547652b82fep+0 + (u < 0.0 ? Number(-0.5) : Number(0.5)));
    k = size < 0x1.62e43p-3 ? Number(0.0) : size < 0x1.0a2b2p-1 ? Number(-1.0) : k;
    const Number high = fused_add(-k, 0x1.62e42feep-1, u), low = k * 0x1.a39ef35793c76p-33;
    const Number r = high - low, c = (high - r) - low;
    const Number half = r * 0.5, h = r * half, square = h * h;
    const Number p1 = fused_add(h, -0x1.11111111110f4p-5, 1.0);
    const Number p2 = fused_add(h, -0x1.4ce199eaadbb7p-14, 0x1.a01a019fe5585p-10);
    const Number p3 = fused_add(h, -0x1.afdb76e09c32dp-23, 0x1.0cfca86e65239p-18);
    const Number p = fused_add(square * square, p3, fused_add(square, p2, p1)), t = fused_add(-p, half, 3.0);
    const Number e = (p - t) / fused_add(-r, t, 6.0) * h, rest = fused_add(e - c, r, -c) - h;
    // By k: 0, -1, below or above 56, up to 19, the others.
    const Number scale = power_of_two(k), inverse = power_of_two(-k), near = r - rest;
    const auto one = k < 0.0 || k > 56.0;
    Number y = k < 20.0 ? (1.0 - inverse) + near : (r - (rest + inverse)) + 1.0;
    y = one ? (1.0 + near) * scale - 1.0 : y * scale;
    y = k == -1.0 ? fused_add(near, 0.5, -0.5) : y;
    y = k == 0.0 ? r - fused_add(e, r, -h) : y;
    Number found = size >= 1.0 ? 1.0 - 2.0 / (y + 2.0) : -y / (y + 2.0);
    found = size >= 22.0 ? Number(1.0) : found;
    return size > 0.0 ? (a < 0.0 ? -found : found) : a;
};
#endif
