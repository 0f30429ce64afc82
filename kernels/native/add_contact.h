// Body of a function (law, velocity, out, in_contact, pack, lane, p, a, b, side, times), after pairs.h and contact_law.h: add
// `times` the forces of a contact on the corner p and on the ends a, b of the side (dx, dy, depth); points of -1 are fixed.

const int unit = pack * (velocity.shape[2] / WIDTH) + lane / WIDTH;
const int point[3] = {p, a, b};
Place speed[3];
Push push[3];
for (int n = 0; n < 3; ++n) {
    speed[n] = Place{0.0, 0.0};
    if (point[n] < 0) continue;
    speed[n] = Place{wp::index(velocity, pack, 2 * point[n], lane), wp::index(velocity, pack, 2 * point[n] + 1, lane)};
}
contact_law(law, side[0], side[1], side[2], times, speed, push);
for (int n = 0; n < 3; ++n) {
    if (point[n] < 0) continue;
    Real &x = wp::index(out, pack, 2 * point[n], lane), &y = wp::index(out, pack, 2 * point[n] + 1, lane);
    wp::index(in_contact, unit, point[n]) = 1;
    x = x + push[n].normal.x;
    y = y + push[n].normal.y;
    x = x + push[n].friction.x;
    y = y + push[n].friction.y;
}
