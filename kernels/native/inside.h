// Body of a function (data, pack, lane, p, r) -> int: the lanes in which point p is in the voxel with points r.

const auto pos = wides(data.pos);
const Wide x = pos[2 * p], y = pos[2 * p + 1];
const Wide x0 = pos[2 * r[0]] - x, y0 = pos[2 * r[0] + 1] - y;
const Wide x1 = pos[2 * r[1]] - x, y1 = pos[2 * r[1] + 1] - y;
const Wide x2 = pos[2 * r[2]] - x, y2 = pos[2 * r[2] + 1] - y;
const Wide x3 = pos[2 * r[3]] - x, y3 = pos[2 * r[3] + 1] - y;
