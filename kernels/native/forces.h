// Forces that lanes and groups compute alike. Their values have the operations `root`, `quotient`, `fused` (a b + c) and
// `reduced` (c - a b), which a group on CUDA approximates; `tanh_of` is that of a number.

// Hooke force k (l - l_eq) of a spring along its vector: (dx, dy) at the sub-step's start with the length l0 `rest` and
// l_eq - l0 `offset`, moved by (ux, uy) since. l - l0 = (|e|^2 - |d|^2) / (l + l0), without the cancellation, and both
// divisions in one; where there is no spring its length may be 0.
auto spring_force = [&](
    Value dx, Value dy, Value ux, Value uy, Value rest, Value offset, Value k, Value& fx, Value& fy
) {
    const Value ex = dx + ux, ey = dy + uy;
    const Value length = root(fused(ex, ex, ey * ey)), both = length + rest;
    const Value excess = reduced(offset, both, fused(dx + ex, ux, (dy + ey) * uy));
    const Value force = quotient(excess * k, fused(both, length, Real(1e-30)));
    fx = force * ex;
    fy = force * ey;
};
// The implicit floor at y = 0: normal force and friction on a point at the height y <= 0 with the velocity vx.
auto floor_force = [&](Real y, Real vx, Real& normal, Real& drag) {
    const double force = -model.floor_stiffness * double(y), most = model.friction * force;
    normal = Real(force);
    drag = Real(model.floor_friction * most * tanh_of(double(vx) * most));
};
