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
auto fused_add = [](auto a, auto b, auto c) { return __builtin_elementwise_fma(a, b, c); };
auto truncated = [](auto a) { return __builtin_elementwise_trunc(a); };
auto power_of_two = [](auto k) {
    k += 0x1.8p52 + 1023.0;  // its last bits are the exponent
    auto shift = [](auto bits, auto number) {
        __builtin_memcpy(&bits, &number, sizeof bits);
        bits <<= 52;
        __builtin_memcpy(&number, &bits, sizeof bits);
        return number;
    };
    if constexpr (sizeof k == sizeof(double)) {
        return shift(0ull, k);
    } else {
        typedef unsigned long long Words __attribute__((ext_vector_type(sizeof k / sizeof(double))));
        return shift(Words{}, k);
    }
};
#endif
auto tanh_of = [&](auto a) {
    typedef decltype(a) Number;
    auto all = [](double x) -> Number { return Number(x); };
    const Number size = a < 0.0 ? -a : a;
    // exp(u) - 1 with u = 2 |a|, or -2 |a| below 1: u = k ln 2 + r, where c is what r lacks. k is -3 to 0, or 3 to 63.
    const Number u = size >= 1.0 ? size + size : -size - size;
    const Number half = u < 0.0 ? all(-0.5) : all(0.5), ln2_low = all(0x1.a39ef35793c76p-33);
    Number k = truncated(u * 0x1.71547652b82fep+0 + half);
    k = size < 0x1.62e43p-3 ? all(0.0) : size < 0x1.0a2b2p-1 ? all(-1.0) : k;  // as released: at the first digits of ln 2
    const Number high = fused_add(-k, all(0x1.62e42feep-1), u), low = k * ln2_low, r = high - low, c = (high - r) - low;
    const Number rh = r * 0.5, h = r * rh, hh = h * h;
    const Number p1 = fused_add(h, all(-0x1.11111111110f4p-5), all(1.0));
    const Number p2 = fused_add(h, all(-0x1.4ce199eaadbb7p-14), all(0x1.a01a019fe5585p-10));
    const Number p3 = fused_add(h, all(-0x1.afdb76e09c32dp-23), all(0x1.0cfca86e65239p-18));
    const Number p = fused_add(hh * hh, p3, fused_add(hh, p2, p1)), t = fused_add(-p, rh, all(3.0));
    Number e = (p - t) / fused_add(-r, t, all(6.0)) * h;
    const Number near = r - fused_add(e, r, -h);
    e = fused_add(e - c, r, -c) - h;
    const Number scale = power_of_two(k), inverse = power_of_two(-k);
    const Number one_less = k < 0.0 || k > 56.0 ? all(1.0) : 1.0 - inverse;
    Number y = k < 20.0 || k > 56.0 ? one_less - (e - r) : (r - (e + inverse)) + 1.0;
    y = k < 0.0 || k > 56.0 ? y * scale - 1.0 : y * scale;
    y = k == -1.0 ? fused_add(all(0.5), r - e, all(-0.5)) : y;
    y = k == 0.0 ? near : y;
    Number found = size >= 1.0 ? 1.0 - 2.0 / (y + 2.0) : -y / (y + 2.0);
    found = size >= 22.0 ? all(1.0) : found;
    return size > 0.0 ? (a < 0.0 ? -found : found) : a;
};
#endif
