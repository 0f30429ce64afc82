// Divergence: the lanes whose state is not finite or out of bounds; DIVERGED is set in their status.

auto find_diverged = [&]() -> int {
    const auto pos = wides(data.pos), vel = wides(data.vel), true_vel = wides(data.true_vel);
    auto within = [&](Wide a, double bound) -> int { return bits_of((a <= bound) & (a >= -bound)); };
    int sound = -1, diverged = 0;
    for (int r = 0; r < 2 * wp::index(model.points, mesh); ++r) {
        sound &= within(pos[r], FARTHEST) & within(vel[r], FASTEST) & within(true_vel[r], FASTEST);
    }
    each_lane([&](int k) {
        if (sound >> k & 1) return;
        diverged |= 1 << k;
        wp::index(data.status, pack, lane + k) |= DIVERGED;
    });
    return diverged;
};
