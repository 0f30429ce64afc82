// Body of a function (pairs, count, ..., begin) -> int, after triangles.h: of the corners of the candidate pairs, numbered
// 8 x pair + 4 x way + corner, the first from `begin` on that is in the other voxel in some lane, or one past the last. Its
// lanes go into `touching`.

const int few = 4;  // lanes up to which one after another is quicker than all at once
const auto pos = wides(places);
const auto box = wides(boxes);

// Those of some lanes in which point p is in the box of voxel j and in the voxel, whose points are r. Mostly one side of the
// box can tell.
auto inside = [&](unsigned p, unsigned j, const wp::vec_t<4, int>& r, int lanes) -> int {
    const Wide x = pos[2 * p], y = pos[2 * p + 1];
    int left = lanes & bits_of(box[4 * j] <= x);
    if (left) left &= bits_of(x <= box[4 * j + 1]);
    if (left) left &= bits_of(box[4 * j + 2] <= y);
    if (left) left &= bits_of(y <= box[4 * j + 3]);
    if (!left) return 0;
    int many = left;
    for (int n = 0; many && n < few; ++n) many &= many - 1;
    if (many) {
        return left & bits_of(in_voxel(
            pos[2 * r[0]] - x, pos[2 * r[0] + 1] - y, pos[2 * r[1]] - x, pos[2 * r[1] + 1] - y,
            pos[2 * r[2]] - x, pos[2 * r[2] + 1] - y, pos[2 * r[3]] - x, pos[2 * r[3] + 1] - y
        ));
    }
    int found = 0;
    for (; left; left &= left - 1) {
        const int k = first_bit(left);
        auto at = [&](int row) -> double { return lane_of(pos[row], k); };
        const double px = at(2 * p), py = at(2 * p + 1);
        if (in_voxel(
            at(2 * r[0]) - px, at(2 * r[0] + 1) - py, at(2 * r[1]) - px, at(2 * r[1] + 1) - py,
            at(2 * r[2]) - px, at(2 * r[2] + 1) - py, at(2 * r[3]) - px, at(2 * r[3] + 1) - py
        )) found |= 1 << k;
    }
    return found;
};

// Lanes in which point p is one of the corners of a voxel by another number.
auto shared = [&](int p, const wp::vec_t<4, int>& corners) -> int {
    const wp::vec_t<2, int> twins = wp::index(twin_range, mesh, p);
    int lanes = 0;
    for (int e = twins[0]; e < twins[1]; ++e) {
        const wp::vec_t<2, int> one = wp::index(twin, mesh, e);
        for (int c = 0; c < 4; ++c) {
            const int q = corners[c];
            if ((one[0] == p && one[1] == q) || (one[0] == q && one[1] == p)) lanes |= wp::index(twin_lanes, mesh, e);
            for (int f = twins[0]; f < twins[1]; ++f) {
                const wp::vec_t<2, int> two = wp::index(twin, mesh, f);
                if (one[0] == p && two[0] == q && one[1] == two[1]) {
                    lanes |= wp::index(twin_lanes, mesh, e) & wp::index(twin_lanes, mesh, f);
                }
            }
        }
    }
    return lanes;
};

const wp::vec_t<4, int>* pair = &wp::index(pairs, unit, 0);
const wp::vec_t<4, int>* corner = &wp::index(corners, mesh, 0);
const wp::vec_t<4, int>* side = &wp::index(side_lanes, mesh, 0);
int done = (1 << (begin & 7)) - 1;  // corners of the first pair that were looked at before
for (int n = begin >> 3; n < count; ++n, done = 0) {
    for (int left = ((pair[n][2] & 15) | (pair[n][3] & 15) << 4) & ~done; left; left &= left - 1) {
        const int bit = first_bit(left), way = bit >> 2, c = bit & 3;
        const int i = pair[n][way], j = pair[n][1 - way];
        int lanes = active & ((side[i][0] | side[i][1] | side[i][2] | side[i][3]) >> lane);
        if (pair[n][2 + way] >> (8 + c) & 1) lanes &= ~(shared(corner[i][c], corner[j]) >> lane);
        if (!lanes) continue;
        const int found = inside(corner[i][c], j, corner[j], lanes);
        if (found) {
            wp::index(touching, unit) = found;
            return 8 * n + bit;
        }
    }
}
return 8 * count;
