// Body of a stage: axis-aligned bounds of the surface voxels that may have moved (`movable`) or of all, into
// `box`; inside out in lanes where a voxel is no surface voxel.

const auto pos = wides(data.pos);
const auto box = wides(data.box);
const int count = movable ? wp::index(model.movables, mesh) : wp::index(model.voxels, mesh);
const int* listed = &wp::index(model.movable, mesh, 0);
for (int n = 0; n < count; ++n) {
    const int v = movable ? listed[n] : n;
    const wp::vec_t<4, int> c = wp::index(model.corner, mesh, v), side = wp::index(model.side_lanes, mesh, v);
    const int lanes = side[0] | side[1] | side[2] | side[3];
    const Wide here = weights(lanes), away = (1.0 - here) * 9.0e5;
    for (int axis = 0; axis < 2; ++axis) {
        Wide low = pos[2 * c[0] + axis], high = low;
        for (int k = 1; k < 4; ++k) {
            const Wide p = pos[2 * c[k] + axis];
            low = p < low ? p : low;
            high = p > high ? p : high;
        }
        if (lanes != -1) {
            low = low * here + away;
            high = high * here - away;
        }
        box[4 * v + 2 * axis] = low;
        box[4 * v + 2 * axis + 1] = high;
    }
}
