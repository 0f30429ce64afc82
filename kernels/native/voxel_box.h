// Body of a function (model, data, design, pack, lane, v): axis-aligned bounds of a voxel, into `box`.

const auto pos = wides(data.pos);
const auto box = wides(data.box);
const wp::vec_t<4, int> c = wp::index(model.corner, design, v);
for (int axis = 0; axis < 2; ++axis) {
    Wide low = pos[2 * c[0] + axis], high = low;
    for (int k = 1; k < 4; ++k) {
        const Wide p = pos[2 * c[k] + axis];
        low = p < low ? p : low;
        high = p > high ? p : high;
    }
    box[4 * v + 2 * axis] = low;
    box[4 * v + 2 * axis + 1] = high;
}
