// Body of a function (m, m_sides, c, r, r_sides), after crossing.h: of the surface sides of quad r that an edge at corner c
// of quad m crosses the nearest, or -1; its vector and how deep the corner is under it.

// Inner bottom and left edges run against the clock, as they were made.
auto edge_crosses = [&](int e, double ax, double ay, double bx, double by) -> bool {
    int from = e, to = (e + 1) & 3;
    if (e >= 2 && !(m_sides >> e & 1)) {
        from = to;
        to = e;
    }
    return crosses(m[2 * from], m[2 * from + 1], m[2 * to], m[2 * to + 1], ax, ay, bx, by);
};
wp::vec_t<4, double> found(-1.0, 0.0, 0.0, 0.0);
for (int e = 0; e < 4; ++e) {
    if (!(r_sides >> e & 1)) continue;
    const int f = (e + 1) & 3;
    const double ax = r[2 * e], ay = r[2 * e + 1], bx = r[2 * f], by = r[2 * f + 1];
    if (!edge_crosses(c, ax, ay, bx, by) && !edge_crosses((c + 3) & 3, ax, ay, bx, by)) continue;
    const double depth = depth_under(m[2 * c], m[2 * c + 1], ax, ay, bx, by);
    if (found[0] < 0.0 || depth < found[3]) found = wp::vec_t<4, double>(double(e), bx - ax, by - ay, depth);
}
return found;
