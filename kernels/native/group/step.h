// A control step of one environment. The state in memory is written at its end alone, and only if the step stands.

auto advance = [&]() {
    const double rate = 1.0 / dt;
    float path = 0.0f;
    sync();
    own_points([&](int j, int p) {  // what is not free moves by 0
        at.pos[p] = Place{at.pos[p].x + move[j][0], at.pos[p].y + move[j][1]};
        path = higher(higher(wp::abs(Single(move[j][0])), wp::abs(Single(move[j][1]))), path);
        at.touch.velocity[p] = Place{move[j][0] * rate, move[j][1] * rate};
        at.contact[p] = no_contact;
    });
    const Single farthest = largest(path) * 1.00001f + Single(model.margin) * 1e-7f;  // rounding of the sums included
    drift += farthest;
    near_drift += farthest;
    sync();
};
auto in_bounds = [&]() -> bool {
    bool good = true;
    own_points([&](int j, int p) {
        const Place pos = at.pos[p], true_vel = at.touch.velocity[p];
        good &= wp::abs(pos.x) <= FARTHEST && wp::abs(pos.y) <= FARTHEST;
        good &= wp::abs(vel[j][0]) <= FASTEST && wp::abs(vel[j][1]) <= FASTEST;
        good &= wp::abs(true_vel.x) <= FASTEST && wp::abs(true_vel.y) <= FASTEST;
    });
    return good;
};
auto put_at_rest = [&]() {
    for (int r = part; r < 2 * points; r += PARTS) {
        wp::index(data.pos, pack, r, 0) = wp::index(model.rest_pos, mesh, r, 0);
        wp::index(data.vel, pack, r, 0) = 0.0;
        wp::index(data.true_vel, pack, r, 0) = 0.0;
    }
};
auto store = [&]() {
    double* pos = &wp::index(data.pos, pack, 0, 0);
    double* velocity = &wp::index(data.vel, pack, 0, 0);
    double* true_vel = &wp::index(data.true_vel, pack, 0, 0);
    own_points([&](int j, int p) {
        const unsigned short* place = at.links[p].place;
        const bool hangs = place[0] != to_subtract || place[LINKS - 1] != to_add;
        if (!(loose >> j & 1) && !hangs) return;
        pos[2 * p] = at.pos[p].x;
        pos[2 * p + 1] = at.pos[p].y;
        velocity[2 * p] = vel[j][0];
        velocity[2 * p + 1] = vel[j][1];
        true_vel[2 * p] = at.touch.velocity[p].x;
        true_vel[2 * p + 1] = at.touch.velocity[p].y;
    });
};

load_points();
if (some_of_group(!sound)) status |= DIVERGED;
if (status & DIVERGED && live) put_at_rest();
if (frozen) status = STILL;
if (frozen && live && part == 0) wp::index(data.status, pack, 0) = 0;
if (status & (DIVERGED | STILL)) points = springs = rigids = count = 0;  // nothing to do but come along
load_springs();
load_rigids();
load_tables();
sync();
ROLL for (int n = 0; n < substeps; ++n) {
    find_tables();
    if (some(drift + drift >= Single(model.margin))) {
        collect();
        drift = 0.0f;
        near_drift = STALE;
    }
    touch();
    sync();
    runge_kutta();
    limit_strain();
    advance();
}
HIDE(pack);  // no addresses are kept from the beginning
if (some_of_group(!in_bounds())) status |= DIVERGED;
if (status & STILL) return;
const bool stands = !(status & (DIVERGED | UNSTABLE));
if (stands) store();
if (part == 0) {
    wp::index(data.status, pack, 0) = status & ~FOLDING;
    if (stands) wp::index(data.time, pack, 0) += 1;
    wp::index(data.drift, pack) = stands ? double(drift) : STALE;
    wp::index(data.pair_count, pack) = pair_count;
    wp::index(data.near_count, pack) = count - pair_count;
    wp::index(data.overflow, pack) = (status & OVERFLOW) != 0;
}
#undef UNROLL
#undef ROLL
#undef EACH_POINT
#undef EACH_SPRING
#undef KEEP
#undef HIDE
#undef GLOBAL
