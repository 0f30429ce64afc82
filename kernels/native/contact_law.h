// The contact law, after pairs.h; sums and products are in the order of the released simulator.

#ifndef UNROLL
#define UNROLL
#endif
// Forces of a contact on the corner and on the two ends of the side (dx, dy), which have these velocities: normal force
// with damping, and friction, viscous at small slip, at most friction_multiplier x friction x normal force. Approximate, in
// single precision from the depth on, as forces are kept.
#if APPROXIMATE
typedef float Force;
#else
typedef double Force;
#endif
auto contact_law = [&](
    const auto& law, double dx, double dy, double depth, double times_wide, const Place* velocity, Push* push
) {
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
#if APPROXIMATE
    const Force saturation = slip != Force(0) ? tanh_of(quotient(slip, friction * size)) : Force(0);
#else
    const Force saturation = slip != Force(0) ? tanh_of(slip / (friction * size)) : Force(0);
#endif
    const Force rx = -(multiplier * tx) * friction * size * saturation, ry = -(multiplier * ty) * friction * size * saturation;
    push[0].friction = Pair{Real(times * rx), Real(times * ry)};
    UNROLL for (int k = 1; k < 3; ++k) {
        const Force v = ux * Force(velocity[k].x) + uy * Force(velocity[k].y);
        push[k].normal = Pair{Real(-(fx * half + ux * v * c * half)), Real(-(fy * half + uy * v * c * half))};
        push[k].friction = Pair{Real(-rx * half), Real(-ry * half)};
    }
};
