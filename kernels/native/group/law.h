// Geometry and law of a contact. Comparisons and their order of evaluation follow the released simulator: at time 0 they
// decide ties in the last bit.

auto least4 = [](auto a, auto b, auto c, auto d) {
    a = b < a ? b : a;
    c = d < c ? d : c;
    return c < a ? c : a;
};
auto most4 = [](auto a, auto b, auto c, auto d) {
    a = b > a ? b : a;
    c = d > c ? d : c;
    return c > a ? c : a;
};
// Whether the segments a-b and c-d cross, ends included.
auto crosses = [](double ax, double ay, double bx, double by, double cx, double cy, double dx, double dy) -> bool {
    const double ux = bx - ax, uy = by - ay, vx = dx - cx, vy = dy - cy;
    const double det = -ux * vy + vx * uy;
    if (wp::abs(det) < PARALLEL) return false;
    // A quotient is below 0 or above 1 exactly where its parts say so, rounding included.
    const double wx = cx - ax, wy = cy - ay, size = wp::abs(det);
    double t = -vy * wx + vx * wy, s = -uy * wx + ux * wy;
    if (det < 0.0) {
        t = -t;
        s = -s;
    }
    return !(t < 0.0 || t > size) && 0.0 <= s && s <= size;
};
// Distance of a point from the line through a and b.
auto depth_under = [](double x, double y, double ax, double ay, double bx, double by) -> double {
    const double ux = bx - ax, uy = by - ay, length = wp::sqrt(ux * ux + uy * uy);
    return length < DEGENERATE ? 1000.0 : wp::abs(ux * (y - ay) - (x - ax) * uy) / length;
};
// Forces of a contact on the corner and on the two ends of the side (dx, dy), which have these velocities: normal force
// with damping, and friction. Approximate, in single precision from the depth on, as forces are kept.
#if APPROXIMATE
typedef float Force;
#else
typedef double Force;
#endif
auto contact_law = [&](double dx, double dy, double depth, double times_wide, const Place* velocity, Push* push) {
    const auto& law = model.contact;
    const Force times = Force(times_wide), half = times * Force(0.5), c = Force(law.damping);
#if APPROXIMATE
    const Force sx = Force(dx), sy = Force(dy), over = inverse_root(sx * sx + sy * sy), nx = -sy * over, ny = sx * over;
    const Force ux = nx, uy = ny, size = Force(law.stiffness * (law.depth + depth)), fx = nx * size, fy = ny * size;
#else
    const Force side = wp::sqrt(dx * dx + dy * dy), nx = -dy / side, ny = dx / side;
    const Force fx = nx * law.stiffness * (law.depth + depth), fy = ny * law.stiffness * (law.depth + depth);
    // The released simulator normalises the unit normal once more before damping and friction.
    const Force length = wp::sqrt(nx * nx + ny * ny), ux = nx / length, uy = ny / length;
    const Force size = wp::sqrt(fx * fx + fy * fy);
#endif
    const Force vx = Force(velocity[0].x), vy = Force(velocity[0].y), speed = ux * vx + uy * vy;
    push[0].normal = Pair{Real(times * (fx - ux * speed * c)), Real(times * (fy - uy * speed * c))};
    Force tx = -uy, ty = ux, slip = tx * vx + ty * vy;
    if (slip < Force(0)) {
        slip = -slip;
        tx = -tx;
        ty = -ty;
    }
    // Without friction or stiffness the quotient would be 0/0.
    const Force friction = Force(law.friction), multiplier = Force(law.friction_multiplier);
    const Force rub = slip != Force(0) ? wp::tanh(slip / (friction * size)) : Force(0);
    const Force rx = -(multiplier * tx) * friction * size * rub, ry = -(multiplier * ty) * friction * size * rub;
    push[0].friction = Pair{Real(times * rx), Real(times * ry)};
    UNROLL for (int k = 1; k < 3; ++k) {
        const Force v = ux * Force(velocity[k].x) + uy * Force(velocity[k].y);
        push[k].normal = Pair{Real(-(fx * half + ux * v * c * half)), Real(-(fy * half + uy * v * c * half))};
        push[k].friction = Pair{Real(-rx * half), Real(-ry * half)};
    }
};
