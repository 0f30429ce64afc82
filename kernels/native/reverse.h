// Body of a function (model, data, tape, mesh, pack, lane, unit, dt), after springs.h and fold_twins.h: from the derivatives
// of a loss by the state at the end of a control step to those by the state at its start and by the goals of the springs.
//
// With p, v, w for position, velocity and true velocity, and h for dt, a sub-step is s = (displacement by RK4), p' = L(p + s)
// with the strain limits L, w' = (p' - p) / h. Springs are linearised: a matrix K, symmetric, for displacements within a
// sub-step, another one for its start, where the relaxation leaves `actuation_rate` of their stiffness.

const int rows = 2 * points;
const int twin_ends = wp::index(model.twin_ends, mesh);
const wp::vec_t<4, int>* twin_end = &wp::index(model.twin_end, mesh, 0);
const int* spring_lanes = &wp::index(model.spring_lanes, mesh, 0);
const int* rigid_spring = &wp::index(model.rigid_spring, mesh, 0);
const int* rigid_lanes = &wp::index(model.rigid_lanes, mesh, 0);
const int rigids = wp::index(model.rigids, mesh);
const double* spring_rest = &wp::index(model.spring_rest, mesh, 0);
const auto pos = values(tape.pos), vel = values(tape.vel), contact = values(tape.contact);
const auto by_pos = values(tape.by_pos), by_vel = values(tape.by_vel), by_true_vel = values(tape.by_true_vel);
const auto by_goal = values(tape.by_goal), by_force = values(tape.by_force);
const auto product = values(tape.product), spring = values(tape.spring);
const auto goal = wides(data.goal);
const Real h = Real(dt), rate = Real(model.actuation_rate), per_mass = model.inverse_mass, drag = model.drag * per_mass;
const int sum = 4 * rows;  // where by_force has the sum of the stages
const Real tiny = Real(1e-20);

// product = the sum over springs of f(x of the first end - x of the second), taken from the first and given to the second.
auto multiply = [&](auto x_of, auto f) __attribute__((always_inline)) {
    for (int n = 0; n < actives; ++n) product[active[n]] = Value{};
    int e = 0, at_twin = twin_ends ? twin_end[0][0] : -1;
    for (int s = 0; s < springs; ++s) {
        const int a = 2 * spring_ends[s][0], b = 2 * spring_ends[s][1];
        Value x = x_of(a) - x_of(b), y = x_of(a + 1) - x_of(b + 1);
        f(s, x, y);
        product[a] = product[a] - x;
        product[a + 1] = product[a + 1] - y;
        product[b] = product[b] + x;
        product[b + 1] = product[b + 1] + y;
        while (s == at_twin) {
            const int t = 2 * twin_end[e][1];
            const Value part = weights(twin_end[e][3]) * (twin_end[e][2] ? Real(1) : Real(-1));
            product[t] = product[t] + x * part;
            product[t + 1] = product[t + 1] + y * part;
            at_twin = ++e < twin_ends ? twin_end[e][0] : -1;
        }
    }
};
// Of a spring: stiffness along it, force density across it.
auto stiffen = [&](int s, Value along, Value& x, Value& y) __attribute__((always_inline)) {
    const Value ex = spring[6 * s], ey = spring[6 * s + 1], density = spring[6 * s + 3];
    const Value part = (ex * x + ey * y) * (along - density);
    x = part * ex + density * x;
    y = part * ey + density * y;
};

// Strain limits, from where points are after the sub-step: what is beyond a limit then was further beyond it before.
// Lanes in which a spring is; then its unit vector.
auto beyond = [&](int s, int lanes, Real bound, int after, Value& ux, Value& uy) -> int {
    const int a = after + 2 * spring_ends[s][0], b = after + 2 * spring_ends[s][1];
    const Value dx = pos[b] - pos[a], dy = pos[b + 1] - pos[a + 1], square = dx * dx + dy * dy;
    const Real rest = Real(spring_rest[s]), longest = rest * (Real(1) + bound), shortest = rest * (Real(1) - bound);
    const int found = bits_of((square >= longest * longest) | (square <= shortest * shortest)) & (lanes >> lane);
    if (!found) return 0;
    const Value over = Real(1) / root(square + tiny);
    ux = dx * over;
    uy = dy * over;
    return found << lane;
};
// A limit moves free points alone.
auto by_free = [&](int r) -> Value { return by_pos[r] * weights(free_lanes[r / 2]); };
// The sides of rigid voxels, in place, from the last to the first.
auto give = [&](int p, Value x, Value y) {
    const Value free = weights(free_lanes[p]);
    by_pos[2 * p] = by_pos[2 * p] + x * free;
    by_pos[2 * p + 1] = by_pos[2 * p + 1] + y * free;
    const int begin = twin_range[p][0], end = twin_range[p][1];
    for (int e = begin; e < end; ++e) {
        if (twin[e][0] != p) continue;
        const Value follows = weights(twin_lanes[e]) * free;
        by_pos[2 * twin[e][1]] = by_pos[2 * twin[e][1]] + x * follows;
        by_pos[2 * twin[e][1] + 1] = by_pos[2 * twin[e][1] + 1] + y * follows;
    }
    for (int e = begin; e < end; ++e) {
        const Value follows = weights(twin_lanes[e]);
        for (int axis = 0; axis < 2; ++axis) {
            const int row = 2 * twin[e][0] + axis, leader = 2 * twin[e][1] + axis;
            by_pos[row] = by_pos[row] * (Real(1) - follows) + by_pos[leader] * follows;
        }
    }
};
auto reverse_rigid_limits = [&](int after) {
    for (int n = rigids - 1; n >= 0; --n) {
        const int s = rigid_spring[n], a = spring_ends[s][0], b = spring_ends[s][1];
        Value ux, uy;
        const int lanes = beyond(s, rigid_lanes[n], model.rigid_strain_limit, after, ux, uy);
        if (!lanes) continue;
        const Value x = by_free(2 * a) - by_free(2 * b), y = by_free(2 * a + 1) - by_free(2 * b + 1);
        const Value part = (ux * x + uy * y) * weights(lanes) * (Real(0.5) * model.rigid_strain_share);
        give(a, -part * ux, -part * uy);
        give(b, part * ux, part * uy);
    }
};
// All springs from one snapshot.
auto reverse_limits = [&](int after) {
    bool limited = false;
    for (int s = 0; s < springs; ++s) {
        const int lanes = beyond(s, spring_lanes[s], model.strain_limit, after, spring[6 * s], spring[6 * s + 1]);
        limited |= lanes != 0;
        spring[6 * s + 2] = weights(lanes) * (Real(0.5) * model.strain_share);
    }
    if (!limited) return;
    multiply(by_free, [&](int s, Value& x, Value& y) {
        const Value ux = spring[6 * s], uy = spring[6 * s + 1], part = (ux * x + uy * y) * spring[6 * s + 2];
        x = part * ux;
        y = part * uy;
    });
    for (int n = 0; n < actives; ++n) by_pos[active[n]] = by_pos[active[n]] + product[active[n]];
};

// Springs: unit vector halfway through the sub-step, stiffness, force density halfway, unit vector at the start. Within a
// sub-step they turn by little, but their stiffness makes it as much as what relaxation leaves of their force.
auto find_springs = [&](int start) {
    for (int s = 0; s < springs; ++s) {
        const int a = start + 2 * spring_ends[s][0], b = start + 2 * spring_ends[s][1];
        const Value dx = pos[b] - pos[a], dy = pos[b + 1] - pos[a + 1], k = spring_k[s];
        const Value wx = (vel[b] - vel[a]) * (h * Real(0.5)), wy = (vel[b + 1] - vel[a + 1]) * (h * Real(0.5));
        const Value over = Real(1) / root(dx * dx + dy * dy + tiny), ux = dx * over, uy = dy * over;
        const Value ex = dx + wx, ey = dy + wy, later = Real(1) / root(ex * ex + ey * ey + tiny);
        const Value relaxed = k * rate * (Real(1) - narrow(goal[s]) * over);
        spring[6 * s] = ex * later;
        spring[6 * s + 1] = ey * later;
        spring[6 * s + 2] = k;
        spring[6 * s + 3] = relaxed + (ux * wx + uy * wy) * over * (k - relaxed);
        spring[6 * s + 4] = ux;
        spring[6 * s + 5] = uy;
    }
};

// The four stages from the last to the first, each of which is a force at v h / 2 or v h, and so on (see integrate.h).
auto reverse_stages = [&]() {
    for (int n = 0; n < actives; ++n) {
        const int r = active[n];
        const Value moves = weights(free_lanes[r / 2]), free = moves * per_mass;
        const Value early = by_pos[r] * free * (h * h / Real(6)), late = by_vel[r] * free * (h / Real(6));
        by_force[r] = early + late;
        by_force[rows + r] = by_force[2 * rows + r] = early + late * Real(2);
        by_force[3 * rows + r] = late;
        by_vel[r] = by_vel[r] + by_pos[r] * moves * h;  // a fixed point stays where it is, whatever its velocity
    }
    for (int stage = 3; stage >= 0; --stage) {
        const int at = stage * rows;
        const Real ahead = stage == 3 ? h : h * Real(0.5);
        if (stage) {
            multiply([&](int r) __attribute__((always_inline)) -> Value { return by_force[at + r]; },
                [&](int s, Value& x, Value& y) __attribute__((always_inline)) { stiffen(s, spring[6 * s + 2], x, y); });
        }
        for (int n = 0; n < actives; ++n) {
            const int r = active[n];
            const Value own = by_force[at + r];
            by_vel[r] = by_vel[r] - own * model.drag;
            by_force[sum + r] = stage == 3 ? own : by_force[sum + r] + own;
            if (!stage) continue;
            by_vel[r] = by_vel[r] + product[r] * ahead;
            by_force[at - rows + r] = by_force[at - rows + r] - own * (drag * ahead);
            if (stage > 1) {
                by_force[at - 2 * rows + r] = by_force[at - 2 * rows + r] + product[r] * (ahead * h * Real(0.5) * per_mass);
            }
        }
    }
};

for (int s = 0; s < springs; ++s) by_goal[s] = Value{};
fold_twins(by_pos, 0, 2);
fold_twins(by_vel, 0, 2);
fold_twins(by_true_vel, 0, 2);
for (int substep = wp::index(tape.substeps, unit) - 2; substep >= 0; --substep) {
    const int start = rows * substep, forces = 3 * start;
    fold_twins(contact, forces, 6);
    for (int n = 0; n < actives; ++n) by_pos[active[n]] = by_pos[active[n]] + by_true_vel[active[n]] / h;
    reverse_rigid_limits(start + rows);
    reverse_limits(start + rows);
    find_springs(start);
    reverse_stages();
    for (int n = 0; n < actives; ++n) by_pos[active[n]] = by_pos[active[n]] - by_true_vel[active[n]] / h;
    multiply([&](int r) __attribute__((always_inline)) -> Value { return by_force[sum + r]; },
        [&](int s, Value& x, Value& y) __attribute__((always_inline)) {
            const Value part = (spring[6 * s] * x + spring[6 * s + 1] * y) * spring[6 * s + 2];
            by_goal[s] = by_goal[s] - part * rate;
            stiffen(s, spring[6 * s + 2], x, y);
            x = x - part * (Real(1) - rate) * spring[6 * s + 4];
            y = y - part * (Real(1) - rate) * spring[6 * s + 5];
        });
    for (int n = 0; n < actives; n += 2) {
        const int x = active[n], y = x + 1, c = forces + 3 * x;
        const Value fx = by_force[sum + x], fy = by_force[sum + y];
        by_pos[x] = by_pos[x] + product[x] + contact[c] * fx + contact[c + 2] * fy;
        by_pos[y] = by_pos[y] + product[y] + contact[c + 1] * fx + contact[c + 3] * fy;
        by_true_vel[x] = contact[c + 4] * fx;
        by_true_vel[y] = contact[c + 5] * fy;
    }
}
