// Body of a stage: candidates among movable voxels, by boxes around all
// lanes first (hulls.h): while lanes are alike that is nearly enough.

const auto box = wides(data.box);
const double margin = model.margin;
const int n = wp::index(model.movables, mesh), words = (wp::index(model.voxels, mesh) + 31) / 32;
const int* movable = &wp::index(model.movable, mesh, 0);
const int* fixed = &wp::index(model.fixed_voxel, mesh, 0);
const double* hull = &wp::index(data.hull, unit, 0);
int* bits = &wp::index(data.pair_bit, unit, 0);
for (int a = 0; a < n; ++a) {
    const int i = movable[a];
    const double slack = 1.001 * margin;
    const double left = hull[4 * a] - slack, right = hull[4 * a + 1] + slack;
    const double low = hull[4 * a + 2] - slack, high = hull[4 * a + 3] + slack;
    const Wide x0 = box[4 * i], x1 = box[4 * i + 1] + margin, y0 = box[4 * i + 2], y1 = box[4 * i + 3] + margin;
    for (int b = a + 1; b < n; ++b) {
        const double* h = hull + 4 * b;
        if (h[0] > right || h[1] < left || h[2] > high || h[3] < low) continue;
        const int j = movable[b];
        if (fixed[i] && fixed[j]) continue;
        const auto meet = (x0 <= box[4 * j + 1] + margin) & (box[4 * j] <= x1) & (y0 <= box[4 * j + 3] + margin)
            & (box[4 * j + 2] <= y1);
        if (bits_of(meet)) bits[i * words + j / 32] |= 1 << (j % 32);
    }
}
