// Forces that lanes and groups compute alike. Their values have the operations `root`, `quotient`, `fused` (a b + c) and
// `reduced` (c - a b), which a group on CUDA approximates.

// Relaxation (paper section A.4) of a spring with the vector (dx, dy) toward the length `goal`; `excess` is goal^2 - l^2, of
// which only the difference needs float64: goal - l = excess / (goal + l). Gives 1 / l^2 and the force density: force over
// length, k (1 - l_eq / l) with l_eq = l + rate (goal - l). Where there is no spring its length may be 0.
auto relaxed = [&](Value dx, Value dy, Value excess, Value goal, Value k, Value& inverse_square, Value& density) {
    const Value square = fused(dx, dx, dy * dy), length = root(square), both = length + goal;
    const Value share = quotient(Value(Real(1)), fused(both, square, Real(1e-30)));
    inverse_square = both * share;
    density = -(excess * Real(model.actuation_rate)) * (length * share) * k;
};
// Hooke force k (l - l_eq) along the vector of a spring, (dx, dy) at the sub-step's start, moved by (ux, uy) since. With w =
// |e|^2 / |d|^2 - 1, found without cancellation, its force density is k s + (1 - s) times that at the start, where
// s = 1 - 1 / sqrt(1 + w). In float32 the series of s has all digits up to |w| = SERIES; float64 takes the root.
constexpr Real SERIES = sizeof(Real) == 4 ? Real(1) / Real(32) : Real(0);
auto spring_force = [&](
    Value dx, Value dy, Value ux, Value uy, Value inverse_square, Value density, Value k, Value& fx, Value& fy
) {
    const Value ex = dx + ux, ey = dy + uy;
    const Value w = fused(dx + ex, ux, (dy + ey) * uy) * inverse_square, square = w * w;
    const Value low = reduced(w, Real(3.0 / 8), Real(1.0 / 2)), middle = reduced(w, Real(35.0 / 128), Real(5.0 / 16));
    Value s = fused(fused(square, Real(63.0 / 256), middle), square, low) * w;
    const auto far = square > Value(SERIES * SERIES);
    if (bits_of(far)) {
        const Value ratio = fused(ex, ex, ey * ey) * inverse_square;
        s = far ? quotient(w, ratio + root(ratio) + Real(1e-20)) : s;
    }
    const Value size = fused(s, k - density, density);
    fx = size * ex;
    fy = size * ey;
};
// The implicit floor at y = 0: normal force and friction where a point is at the height y <= 0, with the velocity vx.
auto floor_contact = [&](Value& fx, Value& fy, Value vx, Value y) {
    const auto below = y <= Value(Real(0));
    const Wide normal = widen(y) * -model.floor_stiffness, most = normal * model.friction;
    const Wide drag = most * model.floor_friction * tanh_of(widen(vx) * most);
    fx = below ? fx - narrow(drag) : fx;
    fy = below ? fy + narrow(normal) : fy;
};
