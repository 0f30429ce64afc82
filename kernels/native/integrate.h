// Body of a stage, after springs.h and forces.h: one sub-step by RK4.
//
// In C++ because it is most of the work: values are vectors of the compiler, which stay in registers. The types and
// operations on them (Value, Wide, widen, root, weights, any_below, ...) are those of scalar.h or vector.h.
//
// The unknown is the displacement since the sub-step's start, never the position: a spring's stretch comes from
// small differences, so that float32 keeps its relative precision wherever the robot stands.

const int twins = wp::index(model.twins, mesh), twin_ends = wp::index(model.twin_ends, mesh);
const wp::vec_t<4, int>* twin_end = &wp::index(model.twin_end, mesh, 0);
const int* last_spring = &wp::index(model.last_spring, mesh, 0);
const Real* stiffness = &wp::index(model.stiffness, mesh, 0);
const bool alike = wp::index(model.alike, mesh);
int* in_contact = &wp::index(data.in_contact, unit, 0);

const auto disp = values(data.disp);
const auto start_vel = values(data.start_vel);
const auto contact = values(data.contact);
const auto stages = values(data.stages);
const auto last_stage = values(data.force);
const unsigned rows = 2 * wp::index(model.points, mesh);
const auto spring = values(data.spring);
const auto goal = wides(data.goal);
const auto pos = wides(data.pos);
const auto vel = wides(data.vel);
const auto true_vel = wides(data.true_vel);

// Forces on the points, in each stage.
auto force = [&](int stage, unsigned r) __attribute__((always_inline)) -> Value& {
    return stage < 3 ? stages[stage * rows + r] : last_stage[r];
};
auto stiffness_of = [&](int s) __attribute__((always_inline)) -> Value { return alike ? Value(stiffness[s]) : spring_k[s]; };
auto relax = [&](int s, unsigned a, unsigned b, Value& fx, Value& fy) __attribute__((always_inline)) {
    const Wide x = pos[b] - pos[a], y = pos[b + 1] - pos[a + 1], aim = goal[s];
    const Value dx = narrow(x), dy = narrow(y);
    Value inverse_square, density;
    relaxed(dx, dy, narrow(aim * aim - (x * x + y * y)), narrow(aim), stiffness_of(s), inverse_square, density);
    const unsigned r = 4 * s;
    spring[r] = dx;
    spring[r + 1] = dy;
    spring[r + 2] = inverse_square;
    spring[r + 3] = density;
    fx = density * dx;
    fy = density * dy;
};
auto stretch = [&](int s, unsigned a, unsigned b, Value& fx, Value& fy) __attribute__((always_inline)) {
    const unsigned r = 4 * s;
    const Value ux = disp[b] - disp[a], uy = disp[b + 1] - disp[a + 1];
    spring_force(spring[r], spring[r + 1], ux, uy, spring[r + 2], spring[r + 3], stiffness_of(s), fx, fy);
};

// x += dt v + dt^2 / 6 (a1 + a2 + a3) and v += dt / 6 (a1 + 2 a2 + 2 a3 + a4), in float64. A fixed point takes part in the
// stages; only its update is dropped.
auto finish = [&](unsigned r, auto free) __attribute__((always_inline)) {
    const Value f1 = force(0, r), f2 = force(1, r), f3 = force(2, r), f4 = force(3, r);
    const Wide velocity = vel[r];
    const auto sixth = free * (dt / 6.0 * double(model.inverse_mass));
    const Wide step = velocity * (free * dt) + widen(f1 + f2 + f3) * (sixth * dt);
    true_vel[r] = step;  // divided by dt after the strain limits
    disp[r] = narrow(step);
    vel[r] = velocity + widen(f1 + f2 * Real(2) + f3 * Real(2) + f4) * sixth;
};

Value lowest = {};  // height at the sub-step's start of the lowest point
// From a point's force in the stage before to its displacement and velocity in this one, and to that part of its force which
// is not of springs.
auto begin_stage = [&](int stage, unsigned x) __attribute__((always_inline)) {
    const Real half = Real(dt) * Real(0.5), ahead = stage < 3 ? half : Real(dt);
    auto velocity = [&](unsigned r) __attribute__((always_inline)) -> Value {
        if (stage == 0) return start_vel[r] = narrow(vel[r]);
        const Value start = start_vel[r], early = stage > 1 ? force(stage - 2, r) : start;
        disp[r] = (stage > 1 ? fused(early, Value(half * model.inverse_mass), start) : start) * ahead;
        return fused(force(stage - 1, r), Value(ahead * model.inverse_mass), start);
    };
    const unsigned y = x + 1, p = x / 2;
    const Value vx = velocity(x), vy = velocity(y);
    const Value drag = Value(model.drag), none = {};
    const bool pushed = !alike || in_contact[p];  // among different bodies most points touch something in some lane
    Value fx = fused(-vx, drag, pushed ? contact[x] : none), fy = fused(-vy, drag, pushed ? contact[y] : none) - model.weight;
    if (any_below(stage ? lowest + disp[y] : lowest)) {
        const Value height = narrow(pos[y]), above = stage ? height + disp[y] : height;
        if (any_below(above)) floor_contact(fx, fy, vx, above);
    }
    force(stage, x) = fx;
    force(stage, y) = fy;
};
auto finish_point = [&](unsigned x) __attribute__((always_inline)) {
    for (unsigned r = x; r < x + 2; ++r) {
        if (free_lanes[x / 2] == -1) {
            finish(r, 1.0);
        } else {
            finish(r, widen(weights(free_lanes[x / 2])));
        }
    }
};

// One stage: adds the forces of all springs to those at their ends, at every point in the order of springs; a point that
// the springs are done with takes the next step. Springs are in the order of their first ends.
auto run_stage = [&](int stage, auto force_of, auto next) __attribute__((always_inline)) {
    int e = 0, n = 0, at_twin = twin_ends ? twin_end[0][0] : -1;
    for (int s = 0; s < springs;) {
        const unsigned a = 2 * spring_ends[s][0];
        Value ax = force(stage, a), ay = force(stage, a + 1);
        do {
            const unsigned b = 2 * spring_ends[s][1];
            Value fx, fy;
            force_of(s, a, b, fx, fy);
            ax = ax + fx;
            ay = ay + fy;
            force(stage, b) = force(stage, b) - fx;
            force(stage, b + 1) = force(stage, b + 1) - fy;
            while (s == at_twin) {
                const unsigned t = 2 * twin_end[e][1];
                const Value part = weights(twin_end[e][3]) * (twin_end[e][2] ? Real(-1) : Real(1));
                force(stage, t) = force(stage, t) + fx * part;
                force(stage, t + 1) = force(stage, t + 1) + fy * part;
                at_twin = ++e < twin_ends ? twin_end[e][0] : -1;
            }
        } while (++s < springs && 2 * spring_ends[s][0] == a);
        force(stage, a) = ax;
        force(stage, a + 1) = ay;
        for (; n < actives && last_spring[n / 2] < s; n += 2) next(active[n]);
    }
    for (; n < actives; n += 2) next(active[n]);
};

// A twin feels what its leader feels.
for (int e = 0; e < twins; ++e) {
    const wp::vec_t<2, int> pair = wp::index(model.twin, mesh, e);
    const Value follows = weights(wp::index(model.twin_lanes, mesh, e));
    for (unsigned axis = 0; axis < 2; ++axis) {
        const unsigned r = 2 * pair[0] + axis;
        contact[r] = contact[r] + contact[2 * pair[1] + axis] * follows;
    }
    in_contact[pair[0]] |= in_contact[pair[1]];
}
for (int n = 0; n < actives; n += 2) {
    const Value height = narrow(pos[active[n + 1]]);
    lowest = n ? smaller(lowest, height) : height;
}
for (int n = 0; n < actives; n += 2) begin_stage(0, active[n]);
run_stage(0, relax, [&](unsigned x) __attribute__((always_inline)) { begin_stage(1, x); });
run_stage(1, stretch, [&](unsigned x) __attribute__((always_inline)) { begin_stage(2, x); });
run_stage(2, stretch, [&](unsigned x) __attribute__((always_inline)) { begin_stage(3, x); });
run_stage(3, stretch, finish_point);
