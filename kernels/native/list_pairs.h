// Body of a stage: the marked candidates in ascending order, into `pairs`,
// with those of their corners that may come to be in the other voxel while the list is in use. Most corners of neighbours
// cannot: a pair without any is left out, unless it counts for self-folding.

typedef wp::vec_t<4, int> Four;
const auto pos = wides(data.pos);
const auto box = wides(data.box);
const double margin = model.margin;
const int words = (wp::index(model.voxels, mesh) + 31) / 32;
const Four* corner = &wp::index(model.corner, mesh, 0);
const Four* side = &wp::index(model.side_lanes, mesh, 0);
const wp::vec_t<2, int>* twins = &wp::index(model.twin_range, mesh, 0);

// Bits of the corners of voxel i that are near voxel j in some lane and no corners of it; 8 bits on, those that are
// corners of it in some lanes, by another number.
auto near_corners = [&](int i, int j) -> int {
    const int lanes = (side[i][0] | side[i][1] | side[i][2] | side[i][3]) >> lane;
    const Wide left = box[4 * j] - margin, right = box[4 * j + 1] + margin;
    const Wide low = box[4 * j + 2] - margin, high = box[4 * j + 3] + margin;
    int bits = 0;
    for (int c = 0; c < 4; ++c) {
        const int p = corner[i][c];
        bool same = false, twin = false;
        for (int d = 0; d < 4; ++d) {
            const int q = corner[j][d];
            same |= p == q;
            twin |= twins[p][0] < twins[p][1] && twins[p] == twins[q];
        }
        if (same) continue;
        const Wide x = pos[2 * p], y = pos[2 * p + 1];
        // Differences: of infinite values they are NaN, which is not near.
        const auto near = (x - left >= 0.0) & (right - x >= 0.0) & (y - low >= 0.0) & (high - y >= 0.0);
        if (lanes & bits_of(near)) bits |= (twin ? 257 : 1) << c;
    }
    return bits;
};

int* marked = &wp::index(data.pair_bit, unit, 0);
int count = 0;
for (int word = 0; word < wp::index(model.voxels, mesh) * words; ++word) {
    for (int bits = marked[word]; bits; bits &= bits - 1) {
        int bit = 0;
        while (!(bits >> bit & 1)) ++bit;
        const int i = word / words, j = 32 * (word % words) + bit;
        int mine = near_corners(i, j), other = near_corners(j, i);
        if (wp::index(model.robot, mesh, i) >= 0 && wp::index(model.body, mesh, i) == wp::index(model.body, mesh, j)) {
            const wp::vec_t<2, int> away = wp::index(model.grid, mesh, i) - wp::index(model.grid, mesh, j);
            if (away[0] * away[0] > 1 || away[1] * away[1] > 1) mine |= DISTANT;
        }
        if (!(mine | other)) continue;
        if (count < data.pairs.shape[1]) {
            wp::index(data.pairs, unit, count++) = Four(i, j, mine, other);
        } else {
            wp::index(data.overflow, unit) = 1;
        }
    }
    marked[word] = 0;
}
wp::index(data.pair_count, unit) = count;
