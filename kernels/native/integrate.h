// Body of a function (model, data, mesh, pack, lane, dt), after springs.h: one sub-step by RK4 for the lanes of a unit.
//
// In C++ because it is most of the work: values are vectors of the compiler, which stay in registers. The types and
// operations on them (Value, Wide, widen, root, weights, any_below, ...) are those of scalar.h or vector.h.
//
// The unknown is the displacement since the sub-step's start, never the position: a spring's stretch comes from
// small differences, so that float32 keeps its relative precision wherever the robot stands.

const int* link_lanes = &wp::index(model.link_lanes, mesh, 0);
const Real tiny = Real(1e-30);  // where there is no spring its length may be 0

const auto disp = values(data.disp);
const auto height = values(data.height);
const auto start_vel = values(data.start_vel);
const auto stage_vel = values(data.stage_vel);
const auto sum_vel = values(data.sum_vel);
const auto sum_bend = values(data.sum_bend);
const auto contact = values(data.contact);
const auto tension = values(data.tension);
const auto span = values(data.span);
const auto rest = values(data.length);
const auto pull = values(data.pull);
const auto pos = wides(data.pos);
const auto vel = wides(data.vel);
const auto move = wides(data.move);

// Hooke force k (l - l_eq) of every spring on its first end; at the start l is its length there and l - l_eq = -pull.
auto stretch_at_start = [&]() {
    for (int s = 0; s < springs; ++s) {
        const Value force = -pull[s] * spring_k[s] / (rest[s] + tiny);
        tension[2 * s] = force * span[2 * s];
        tension[2 * s + 1] = force * span[2 * s + 1];
    }
};
auto stretch_springs = [&]() {
    for (int s = 0; s < springs; ++s) {
        const unsigned a = 2 * spring_ends[s][0], b = 2 * spring_ends[s][1];
        const Value ux = disp[b] - disp[a], uy = disp[b + 1] - disp[a + 1];
        spring_force(
            span[2 * s], span[2 * s + 1], ux, uy, rest[s], pull[s], spring_k[s], tension[2 * s], tension[2 * s + 1]
        );
    }
};

// The implicit floor at y = 0: normal force and friction of the lanes that are below it.
auto stand = [&](Value& fx, Value& fy, const Value& vx, const Value& y) {
    each_lane([&](int k) {
        if (lane_of(y, k) <= Real(0)) {
            Real normal, drag;
            floor_force(lane_of(y, k), lane_of(vx, k), normal, drag);
            set_lane(fx, k, lane_of(fx, k) - drag);
            set_lane(fy, k, lane_of(fy, k) + normal);
        }
    });
};

// Contact, drag, gravity, floor and springs, in this order, on a point at height `above` with velocity vx, vy.
auto point_force = [&](unsigned p, Value vx, Value vy, Value above, Value& fx, Value& fy) {
    fx = contact[2 * p] - vx * model.drag;
    fy = contact[2 * p + 1] - vy * model.drag - model.weight;
    if (any_below(above)) stand(fx, fy, vx, above);
    for (int n = link_start[p]; n < link_start[p + 1]; ++n) {
        const int s = link[n], lanes = link_lanes[n];
        const unsigned t = 2 * (s >= 0 ? s : -1 - s);
        if (lanes != -1) {
            const Value part = weights(lanes) * (s >= 0 ? Real(1) : Real(-1));
            fx = fx + tension[t] * part;
            fy = fy + tension[t + 1] * part;
        } else if (s >= 0) {
            fx = fx + tension[t];
            fy = fy + tension[t + 1];
        } else {
            fx = fx - tension[t];
            fy = fy - tension[t + 1];
        }
    }
};

// x += dt v + dt^2 / 6 (a1 + a2 + a3) and v += dt / 6 (a1 + 2 a2 + 2 a3 + a4), in float64. A fixed point takes part in the
// stages; only its update is dropped.
auto finish = [&](unsigned r, Value sum, auto free) {
    const Wide velocity = vel[r];
    const auto sixth = free * dt / 6.0;
    const Wide step = velocity * (free * dt) + widen(sum_bend[r]) * (sixth * dt);
    move[r] = step;
    disp[r] = narrow(step);
    vel[r] = velocity + widen(sum) * sixth;
};

// A twin feels what its leader feels.
for (int e = 0; e < wp::index(model.twins, mesh); ++e) {
    const wp::vec_t<2, int> pair = wp::index(model.twin, mesh, e);
    const Value follows = weights(wp::index(model.twin_lanes, mesh, e));
    for (unsigned axis = 0; axis < 2; ++axis) {
        const unsigned r = 2 * pair[0] + axis;
        contact[r] = contact[r] + contact[2 * pair[1] + axis] * follows;
    }
}

for (int stage = 0; stage < 4; ++stage) {
    const Real ahead = stage < 2 ? Real(dt) * Real(0.5) : Real(dt);
    if (stage == 0) {
        stretch_at_start();
    } else {
        stretch_springs();
    }
    for (int n = 0; n < actives; n += 2) {
        const unsigned x = active[n], p = x / 2;
        if (stage == 0) {
            start_vel[x] = stage_vel[x] = narrow(vel[x]);
            start_vel[x + 1] = stage_vel[x + 1] = narrow(vel[x + 1]);
            height[p] = narrow(pos[x + 1]);
        }
        const Value velocity[2] = {stage_vel[x], stage_vel[x + 1]};
        Value force[2];
        point_force(p, velocity[0], velocity[1], stage == 0 ? height[p] : height[p] + disp[x + 1], force[0], force[1]);
        for (unsigned axis = 0; axis < 2; ++axis) {
            const unsigned r = x + axis;
            const Value a = force[axis] * model.inverse_mass;
            if (stage == 3) {
                if (free_lanes[p] == -1) {
                    finish(r, sum_vel[r] + a, 1.0);
                } else {
                    finish(r, sum_vel[r] + a, widen(weights(free_lanes[p])));
                }
                continue;
            }
            if (stage == 0) {
                sum_vel[r] = a;
            } else {
                sum_bend[r] = (stage == 1 ? sum_vel[r] : sum_bend[r]) + a;
                sum_vel[r] = sum_vel[r] + a * Real(2);
            }
            disp[r] = velocity[axis] * ahead;
            stage_vel[r] = start_vel[r] + a * ahead;
        }
    }
}
