// Body of a stage: boxes of the mobile voxels around all lanes, into `hull`.

const auto box = wides(data.box);
const int* mobile = &wp::index(model.mobile, mesh, 0);
double* hull = &wp::index(data.hull, unit, 0);
for (int n = 0; n < wp::index(model.mobiles, mesh); ++n) {
    for (int side = 0; side < 4; ++side) {
        hull[4 * n + side] = side % 2 ? largest(box[4 * mobile[n] + side]) : least(box[4 * mobile[n] + side]);
    }
}
