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
const auto stages = values(data.stages);  // accelerations of the first three stages
const auto contact = values(data.contact);
const auto force = values(data.force);
const Real tiny = Real(1e-30);  // where there is no spring its length may be 0
const auto spring = values(data.spring);
const auto goal = wides(data.goal);
const auto pos = wides(data.pos);
const auto vel = wides(data.vel);
const auto true_vel = wides(data.true_vel);

auto stiffness_of = [&](int s) __attribute__((always_inline)) -> Value { return alike ? Value(stiffness[s]) : spring_k[s]; };
auto relax = [&](int s, unsigned a, unsigned b, Value& fx, Value& fy) __attribute__((always_inline)) {
    const Wide x = pos[b] - pos[a], y = pos[b + 1] - pos[a + 1], length = root_wide(x * x + y * y);
    const Value dx = narrow(x), dy = narrow(y), start = narrow(length);
    const Value change = narrow((goal[s] - length) * model.actuation_rate);
    const Value size = -change * stiffness_of(s) / (start + tiny);
    const unsigned r = 4 * s;
    spring[r] = dx;
    spring[r + 1] = dy;
    spring[r + 2] = start;
    spring[r + 3] = change;
    fx = size * dx;
    fy = size * dy;
};
auto stretch = [&](int s, unsigned a, unsigned b, Value& fx, Value& fy) __attribute__((always_inline)) {
    const unsigned r = 4 * s;
    const Value ux = disp[b] - disp[a], uy = disp[b + 1] - disp[a + 1];
    spring_force(spring[r], spring[r + 1], ux, uy, spring[r + 2], spring[r + 3], stiffness_of(s), fx, fy);
};

// The implicit floor at y = 0: normal force and friction in the lanes that are below it.
auto floor_contact = [&](Value& fx, Value& fy, Value vx, Value y) {
    Value x_force = fx, y_force = fy;
    each_lane([&](int k) {
        if (lane_of(y, k) <= Real(0)) {
            Real normal, drag;
            floor_force(lane_of(y, k), lane_of(vx, k), normal, drag);
            set_lane(x_force, k, lane_of(x_force, k) - drag);
            set_lane(y_force, k, lane_of(y_force, k) + normal);
        }
    });
    fx = x_force;
    fy = y_force;
};

// x += dt v + dt^2 / 6 (a1 + a2 + a3) and v += dt / 6 (a1 + 2 a2 + 2 a3 + a4), in float64. A fixed point takes part in the
// stages; only its update is dropped.
auto finish = [&](unsigned r, Value a1, Value a2, Value a3, Value a4, auto free) __attribute__((always_inline)) {
    const Wide velocity = vel[r];
    const auto sixth = free * dt / 6.0;
    const Wide step = velocity * (free * dt) + widen(a1 + a2 + a3) * (sixth * dt);
    true_vel[r] = step;  // divided by dt after the strain limits
    disp[r] = narrow(step);
    vel[r] = velocity + widen(a1 + a2 * Real(2) + a3 * Real(2) + a4) * sixth;
};

Value lowest = {};  // height at the sub-step's start of the lowest point
// From a point's force in the stage before to its displacement and velocity in this one, and to that part of its force which
// is not of springs.
auto begin_stage = [&](int stage, unsigned x) __attribute__((always_inline)) {
    const Real half = Real(dt) * Real(0.5), ahead = stage < 3 ? half : Real(dt);
    auto velocity = [&](unsigned r) __attribute__((always_inline)) -> Value {
        if (stage == 0) return start_vel[r] = narrow(vel[r]);
        const Value a = force[r] * model.inverse_mass;
        disp[r] = (stage > 1 ? fused(stages[3 * r + stage - 2], Value(half), start_vel[r]) : start_vel[r]) * ahead;
        stages[3 * r + stage - 1] = a;
        return fused(a, Value(ahead), start_vel[r]);
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
    force[x] = fx;
    force[y] = fy;
};
auto finish_point = [&](unsigned x) __attribute__((always_inline)) {
    for (unsigned r = x; r < x + 2; ++r) {
        const Value a = force[r] * model.inverse_mass;
        if (free_lanes[x / 2] == -1) {
            finish(r, stages[3 * r], stages[3 * r + 1], stages[3 * r + 2], a, 1.0);
        } else {
            finish(r, stages[3 * r], stages[3 * r + 1], stages[3 * r + 2], a, widen(weights(free_lanes[x / 2])));
        }
    }
};

// One stage: adds the forces of all springs to those at their ends, at every point in the order of springs; a point that
// the springs are done with takes the next step. Springs are in the order of their first ends.
auto run_stage = [&](auto force_of, auto next) __attribute__((always_inline)) {
    int e = 0, n = 0, at_twin = twin_ends ? twin_end[0][0] : -1;
    for (int s = 0; s < springs;) {
        const unsigned a = 2 * spring_ends[s][0];
        Value ax = force[a], ay = force[a + 1];
        do {
            const unsigned b = 2 * spring_ends[s][1];
            Value fx, fy;
            force_of(s, a, b, fx, fy);
            ax = ax + fx;
            ay = ay + fy;
            force[b] = force[b] - fx;
            force[b + 1] = force[b + 1] - fy;
            while (s == at_twin) {
                const unsigned t = 2 * twin_end[e][1];
                const Value part = weights(twin_end[e][3]) * (twin_end[e][2] ? Real(-1) : Real(1));
                force[t] = force[t] + fx * part;
                force[t + 1] = force[t + 1] + fy * part;
                at_twin = ++e < twin_ends ? twin_end[e][0] : -1;
            }
        } while (++s < springs && 2 * spring_ends[s][0] == a);
        force[a] = ax;
        force[a + 1] = ay;
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
run_stage(relax, [&](unsigned x) __attribute__((always_inline)) { begin_stage(1, x); });
run_stage(stretch, [&](unsigned x) __attribute__((always_inline)) { begin_stage(2, x); });
run_stage(stretch, [&](unsigned x) __attribute__((always_inline)) { begin_stage(3, x); });
run_stage(stretch, finish_point);
