// Body of a stage, after springs.h: strain limits on the new positions in `disp`, then the step to them.

const int* rigid_spring = &wp::index(model.rigid_spring, mesh, 0);
const double* spring_rest = &wp::index(model.spring_rest, mesh, 0);
const auto place = values(data.disp);
const auto correction = values(data.force);
const auto pos = values(data.pos);
const auto true_vel = values(data.true_vel);

// How far the first end of spring s moves away from the second, and whether it does in any lane.
auto correct = [&](int s, double bound, double share, Value& dx, Value& dy) -> bool {
    const unsigned a = 2 * spring_ends[s][0], b = 2 * spring_ends[s][1];
    dx = place[a] - place[b];
    dy = place[a + 1] - place[b + 1];
    const double rest = spring_rest[s], longest = rest * (1.0 + bound), shortest = rest * (1.0 - bound);
    const Value length = root(dx * dx + dy * dy), stress = length / rest;
    if (!bits_of((stress >= 1.0 + bound) | (stress <= 1.0 - bound))) return false;
    const Value over = length - longest, under = length - shortest, zero = {};
    const Value part = ((zero > over ? zero : over) + (zero < under ? zero : under)) / (length * 2.0);
    dx = dx * part * share;
    dy = dy * part * share;
    return true;
};
auto shift = [&](int p, Value dx, Value dy) {
    if (!free_lanes[p]) return;
    place[2 * p] = place[2 * p] + dx;
    place[2 * p + 1] = place[2 * p + 1] + dy;
};

// All springs from one snapshot: noted, then taken by all first ends, then by all second ends.
bool any = false;
for (int s = 0; s < springs; ++s) {
    Value dx, dy, zero = {};
    const bool strained = correct(s, model.strain_limit, model.strain_share, dx, dy);
    any |= strained;
    correction[2 * s] = strained ? dx : zero;
    correction[2 * s + 1] = strained ? dy : zero;
}
for (int end = 0; any && end < 2; ++end) {
    const double sign = end ? 1.0 : -1.0;
    for (int s = 0; s < springs; ++s) shift(spring_ends[s][end], correction[2 * s] * sign, correction[2 * s + 1] * sign);
}
// The sides of rigid voxels one after another, in place.
for (int n = 0; n < wp::index(model.rigids, mesh); ++n) {
    const int s = rigid_spring[n];
    Value dx, dy;
    if (!correct(s, model.rigid_strain_limit, model.rigid_strain_share, dx, dy)) continue;
    shift(spring_ends[s][0], -dx, -dy);
    shift(spring_ends[s][1], dx, dy);
}
Value path = {};
for (int n = 0; n < actives; ++n) {
    const unsigned r = active[n];
    const Value step = place[r] - pos[r];
    pos[r] = place[r];
    true_vel[r] = step / dt;
    path = longer(path, step);
}
wp::index(data.drift, unit) += largest(path);
