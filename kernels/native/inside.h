// Body of a function (places, boxes, pack, lane, p, j, r, lanes) -> int: those of some lanes in which point p is in the box
// of voxel j and in the voxel, whose points are r. Arrays instead of Data, which would be copied where the call is not
// inlined. Mostly one side of the box is enough to tell.

const auto pos = wides(places);
const auto box = wides(boxes);
const Wide x = pos[2 * p], y = pos[2 * p + 1];
int left = lanes & bits_of(box[4 * j] <= x);
if (left) left &= bits_of(x <= box[4 * j + 1]);
if (left) left &= bits_of(box[4 * j + 2] <= y);
if (left) left &= bits_of(y <= box[4 * j + 3]);
if (!left) return 0;
auto answer = [&](auto inside) -> int { return left & bits_of(inside); };
const Wide x0 = pos[2 * r[0]] - x, y0 = pos[2 * r[0] + 1] - y;
const Wide x1 = pos[2 * r[1]] - x, y1 = pos[2 * r[1] + 1] - y;
const Wide x2 = pos[2 * r[2]] - x, y2 = pos[2 * r[2] + 1] - y;
const Wide x3 = pos[2 * r[3]] - x, y3 = pos[2 * r[3] + 1] - y;
