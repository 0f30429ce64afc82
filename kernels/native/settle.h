// Body of a stage, after springs.h and bounds.h: frozen and stopped lanes go back to the start of the control step.

find_diverged();
each_lane([&](int k) {
    const int e = lane + k;
    int& status = wp::index(data.status, pack, e);
    const bool frozen = wp::index(data.frozen, pack, e) == 1;
    status = frozen ? 0 : wp::index(data.overflow, unit) == 1 ? status | OVERFLOW : status;
    if (!frozen && !(status & (UNSTABLE | DIVERGED))) {
        ++wp::index(data.time, pack, e);
        return;
    }
    for (int n = 0; n < actives; ++n) {
        const int r = active[n];
        wp::index(data.pos, pack, r, e) = wp::index(data.saved_pos, pack, r, e);
        wp::index(data.vel, pack, r, e) = wp::index(data.saved_vel, pack, r, e);
        wp::index(data.true_vel, pack, r, e) = wp::index(data.saved_true_vel, pack, r, e);
    }
    wp::index(data.drift, unit) = STALE;
});
