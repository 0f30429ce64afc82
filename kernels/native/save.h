// Body of a stage, after springs.h and bounds.h: save the state; lanes that have diverged are put at rest first.

const int diverged = find_diverged();
each_lane([&](int k) {
    if (!(diverged >> k & 1)) return;
    for (int r = 0; r < 2 * wp::index(model.points, mesh); ++r) {
        wp::index(data.pos, pack, r, lane + k) = wp::index(model.rest_pos, mesh, r, lane + k);
        wp::index(data.vel, pack, r, lane + k) = wp::index(data.true_vel, pack, r, lane + k) = 0.0;
    }
    wp::index(data.drift, unit) = STALE;
});
const auto pos = wides(data.pos), vel = wides(data.vel), true_vel = wides(data.true_vel);
const auto saved_pos = wides(data.saved_pos), saved_vel = wides(data.saved_vel), saved_true_vel = wides(data.saved_true_vel);
for (int n = 0; n < actives; ++n) {
    const unsigned r = active[n];
    saved_pos[r] = pos[r];
    saved_vel[r] = vel[r];
    saved_true_vel[r] = true_vel[r];
}
