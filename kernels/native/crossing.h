// Geometry of a contact. Comparisons and their order of evaluation follow the released simulator: at time 0 they decide
// ties in the last bit.

// Whether the segments a-b and c-d cross, ends included.
auto crosses = [](double ax, double ay, double bx, double by, double cx, double cy, double dx, double dy) -> bool {
    const double ux = bx - ax, uy = by - ay, vx = dx - cx, vy = dy - cy;
    const double det = -ux * vy + vx * uy;
    if (wp::abs(det) < PARALLEL) return false;
    // A quotient is below 0 or above 1 exactly where its parts say so, rounding included.
    const double wx = cx - ax, wy = cy - ay, size = wp::abs(det);
    double t = -vy * wx + vx * wy, s = -uy * wx + ux * wy;
    if (det < 0.0) {
        t = -t;
        s = -s;
    }
    return !(t < 0.0 || t > size) && 0.0 <= s && s <= size;
};
// Distance of a point from the line through a and b.
auto depth_under = [](double x, double y, double ax, double ay, double bx, double by) -> double {
    const double ux = bx - ax, uy = by - ay, length = wp::sqrt(ux * ux + uy * uy);
    return length < DEGENERATE ? 1000.0 : wp::abs(ux * (y - ay) - (x - ax) * uy) / length;
};
