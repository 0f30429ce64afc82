// Body of a stage, after springs.h: one sub-step by RK4 in float64.
//
// The physics of integrate.h, rounded as the released simulator rounds: the unknown is the position, and every sum and
// product is taken in its order. At a point that is the springs that begin there, those that end there (the order of
// link), drag, gravity, contact, floor.

const int* link = &wp::index(model.link, mesh, 0);
const int* link_start = &wp::index(model.link_start, mesh, 0);
const auto place = values(data.disp);
const int rows = 2 * wp::index(model.points, mesh);
const auto stages = values(data.stages);
auto stage_vel = [&](unsigned r) -> Value& { return stages[r]; };
auto sum_vel = [&](unsigned r) -> Value& { return stages[rows + r]; };
auto sum_path = [&](unsigned r) -> Value& { return stages[2 * rows + r]; };
const auto contact = values(data.contact);
const auto tension = values(data.force);
const auto equilibrium = values(data.spring);
const auto goal = values(data.goal);
const auto pos = values(data.pos);
const auto vel = values(data.vel);

auto stretch_springs = [&](int stage) {
    for (int s = 0; s < springs; ++s) {
        const unsigned a = 2 * spring_ends[s][0], b = 2 * spring_ends[s][1];
        const Value ex = place[a] - place[b], ey = place[a + 1] - place[b + 1];
        const Value length = root(ex * ex + ey * ey);
        if (stage == 0) equilibrium[s] = length + (goal[s] - length) * model.actuation_rate;
        const Value force = (length - equilibrium[s]) * spring_k[s] / length;
        tension[2 * s] = ex * force;
        tension[2 * s + 1] = ey * force;
    }
};

// The implicit floor at y = 0.
auto floor_contact = [&](Value& fx, Value& fy, const Value& vx, const Value& y) {
    const auto below = y <= Value(0.0);
    const Value normal = y * -model.floor_stiffness, saturation = tanh_of(vx * normal * model.friction);
    fx = below ? fx + -model.floor_friction * model.friction * (normal * saturation) : fx;
    fy = below ? fy + normal : fy;
};

auto point_force = [&](unsigned x, Value& fx, Value& fy) {
    const unsigned y = x + 1, p = x / 2;
    fx = stage_vel(x) * 0.0;
    fy = fx;
    for (int n = link_start[p]; n < link_start[p + 1]; ++n) {
        const int s = link[n];
        if (s >= 0) {
            fx = fx - tension[2 * s];
            fy = fy - tension[2 * s + 1];
        } else {
            fx = fx + tension[-2 * s - 2];
            fy = fy + tension[-2 * s - 1];
        }
    }
    fx = fx + stage_vel(x) * -model.drag + contact[x];
    fy = fy + stage_vel(y) * -model.drag + -model.weight + contact[y];
    if (any_below(place[y])) floor_contact(fx, fy, stage_vel(x), place[y]);
};

for (int n = 0; n < actives; ++n) {
    const unsigned r = active[n];
    place[r] = pos[r];
    stage_vel(r) = vel[r];
    sum_path(r) = vel[r] * 0.0;
    sum_vel(r) = vel[r] * 0.0;
}
for (int stage = 0; stage < 4; ++stage) {
    const double weight = stage == 1 || stage == 2 ? 2.0 : 1.0, ahead = stage < 2 ? 0.5 : 1.0;
    stretch_springs(stage);
    for (int n = 0; n < actives; n += 2) {
        const unsigned x = active[n];
        Value force[2];
        point_force(x, force[0], force[1]);
        for (unsigned axis = 0; axis < 2; ++axis) {
            const unsigned r = x + axis;
            const Value path = stage_vel(r) * dt, gain = force[axis] * model.inverse_mass * dt;
            sum_path(r) = sum_path(r) + path * weight;
            sum_vel(r) = sum_vel(r) + gain * weight;
            place[r] = pos[r] + path * ahead;
            stage_vel(r) = vel[r] + gain * ahead;
        }
    }
}
for (int n = 0; n < actives; ++n) {
    const unsigned r = active[n];
    // A fixed point takes part in the stages; only its update is dropped.
    const double free = free_lanes[r / 2] ? 1.0 : 0.0;
    place[r] = pos[r] + sum_path(r) * free / 6.0;
    vel[r] = vel[r] + sum_vel(r) * free / 6.0;
}
