// Body of a function (x, y, r) -> bool: whether a point is in quad r.

auto answer = [](bool a) -> bool { return a; };
const double x0 = r[0] - x, y0 = r[1] - y, x1 = r[2] - x, y1 = r[3] - y;
const double x2 = r[4] - x, y2 = r[5] - y, x3 = r[6] - x, y3 = r[7] - y;
