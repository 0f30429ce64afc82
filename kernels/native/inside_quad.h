// Body of a function (x, y, r) -> bool, after triangles.h: whether a point is in quad r.

return in_voxel(r[0] - x, r[1] - y, r[2] - x, r[3] - y, r[4] - x, r[5] - y, r[6] - x, r[7] - y);
