// Body of a stage, after springs.h: both strain passes on displacements, then the step to the new positions.

const int rigids = wp::index(model.rigids, mesh);
const int* spring_lanes = &wp::index(model.spring_lanes, mesh, 0);
const int* rigid_spring = &wp::index(model.rigid_spring, mesh, 0);
const int* rigid_lanes = &wp::index(model.rigid_lanes, mesh, 0);
const int* twin_lanes = &wp::index(model.twin_lanes, mesh, 0);
const wp::vec_t<2, int>* twin_range = &wp::index(model.twin_range, mesh, 0);
const wp::vec_t<2, int>* twin = &wp::index(model.twin, mesh, 0);
const double* spring_rest = &wp::index(model.spring_rest, mesh, 0);

const auto disp = values(data.disp);
const auto spring = values(data.spring);
const auto moved = values(data.stages);  // corrections of a pass; what Runge-Kutta left there is not needed any more
const int points = wp::index(model.points, mesh);
int* corrected = &wp::index(data.corrected, unit, 0);
const auto pos = wides(data.pos);
const auto true_vel = wides(data.true_vel);  // displacements of the sub-step until the end

// Whether spring s is beyond the bound in some of the lanes; then how far its first end moves, toward the second where
// the spring is too long.
auto correction = [&](int s, int lanes, Real bound, Real share, Value& dx, Value& dy) -> bool {
    const unsigned a = 2 * spring_ends[s][0], b = 2 * spring_ends[s][1];
    const Value ex = spring[4 * s] + (disp[b] - disp[a]), ey = spring[4 * s + 1] + (disp[b + 1] - disp[a + 1]);
    const Value square = ex * ex + ey * ey;
    const Real rest = static_cast<Real>(spring_rest[s]);
    const Real longest = rest * (Real(1) + bound), shortest = rest * (Real(1) - bound);
    if (!(bits_of((square >= longest * longest) | (square <= shortest * shortest)) & (lanes >> lane))) return false;
    const Value length = root(square), zero = length * Real(0);
    const Value over = length - longest, under = length - shortest;
    const Value excess = (over > zero ? over : zero) + (under < zero ? under : zero);
    Value part = excess * (Real(0.5) * share) / length;
    if (lanes != -1) part = weights(lanes) > zero ? part : zero;
    dx = ex * part;
    dy = ey * part;
    return true;
};

// Corrections of a point begin with 0.
auto note = [&](int p) {
    if (corrected[p]) return;
    corrected[p] = 1;
    moved[2 * p] = moved[2 * p + 1] = Value{};
};
// Move a point where it is free, in the corrections alone or in the displacements, too; twins move with their leader.
auto shift = [&](int p, Value x, Value y, bool in_place) {
    const int free = free_lanes[p], begin = twin_range[p][0], end = twin_range[p][1];
    if (free == 0) return;
    note(p);
    for (int e = begin; e < end; ++e) {
        note(twin[e][0]);
        note(twin[e][1]);
    }
    if (free != -1) {
        x = x * weights(free);
        y = y * weights(free);
    }
    for (int k = 0; k < (in_place ? 2 : 1); ++k) {
        const auto rows = k ? disp : moved;
        Value own_x = x, own_y = y;
        for (int e = begin; e < end; ++e) {
            if (twin[e][0] == p) {
                const Value follows = weights(twin_lanes[e]);
                const unsigned leader = 2 * twin[e][1];
                rows[leader] = rows[leader] + own_x * follows;
                rows[leader + 1] = rows[leader + 1] + own_y * follows;
                own_x = own_x * (Real(1) - follows);
                own_y = own_y * (Real(1) - follows);
            }
        }
        rows[2 * p] = rows[2 * p] + own_x;
        rows[2 * p + 1] = rows[2 * p + 1] + own_y;
        for (int e = begin; e < end; ++e) {
            const Value follows = weights(twin_lanes[e]), own = Real(1) - follows;
            for (unsigned axis = 0; axis < 2; ++axis) {
                const unsigned row = 2 * twin[e][0] + axis, leader = 2 * twin[e][1] + axis;
                rows[row] = rows[row] * own + rows[leader] * follows;
            }
        }
    }
};

Value dx, dy;
for (int p = 0; p < points; ++p) corrected[p] = 0;

// All springs from one snapshot.
for (int s = 0; s < springs; ++s) {
    if (correction(s, spring_lanes[s], model.strain_limit, model.strain_share, dx, dy)) {
        shift(spring_ends[s][0], dx, dy, false);
        shift(spring_ends[s][1], -dx, -dy, false);
    }
}
for (int n = 0; n < actives; n += 2) {
    const unsigned x = active[n];
    if (!corrected[x / 2]) continue;
    corrected[x / 2] = 0;
    for (unsigned r = x; r < x + 2; ++r) {
        disp[r] = disp[r] + moved[r];
        true_vel[r] = true_vel[r] + widen(moved[r]);
    }
}
// The sides of rigid voxels one after another, in place.
for (int n = 0; n < rigids; ++n) {
    const int s = rigid_spring[n];
    if (correction(s, rigid_lanes[n], model.rigid_strain_limit, model.rigid_strain_share, dx, dy)) {
        shift(spring_ends[s][0], dx, dy, true);
        shift(spring_ends[s][1], -dx, -dy, true);
    }
}
// New positions, true velocities, and the longest path of a point.
const double rate = 1.0 / dt;
Wide path = {};
for (int n = 0; n < actives; ++n) {
    const unsigned r = active[n];
    Wide step = true_vel[r];
    if (corrected[r / 2]) step = step + widen(moved[r]);
    pos[r] = pos[r] + step;
    true_vel[r] = step * rate;
    path = longer(path, step);
}
wp::index(data.drift, unit) += largest(path);
