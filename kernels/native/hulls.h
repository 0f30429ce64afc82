// Body of a stage: boxes of the movable voxels around all lanes, into `hull`.

const auto box = wides(data.box);
const int* movable = &wp::index(model.movable, mesh, 0);
double* hull = &wp::index(data.hull, unit, 0);
for (int n = 0; n < wp::index(model.movables, mesh); ++n) {
    for (int side = 0; side < 4; ++side) {
        hull[4 * n + side] = side % 2 ? largest(box[4 * movable[n] + side]) : least(box[4 * movable[n] + side]);
    }
}
