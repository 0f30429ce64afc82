// Body of a function (places, boxes, pack, lane, p, j, r) -> int: the lanes in which point p is in the box of voxel j and
// in the voxel, whose points are r. Arrays instead of Data, which would be copied where the call is not inlined.

const auto pos = wides(places);
const auto box = wides(boxes);
const Wide x = pos[2 * p], y = pos[2 * p + 1];
const auto in_box = (box[4 * j] <= x) & (x <= box[4 * j + 1]) & (box[4 * j + 2] <= y) & (y <= box[4 * j + 3]);
if (!bits_of(in_box)) return 0;
auto answer = [&](auto inside) -> int { return bits_of(in_box & inside); };
const Wide x0 = pos[2 * r[0]] - x, y0 = pos[2 * r[0] + 1] - y;
const Wide x1 = pos[2 * r[1]] - x, y1 = pos[2 * r[1] + 1] - y;
const Wide x2 = pos[2 * r[2]] - x, y2 = pos[2 * r[2] + 1] - y;
const Wide x3 = pos[2 * r[3]] - x, y3 = pos[2 * r[3] + 1] - y;
