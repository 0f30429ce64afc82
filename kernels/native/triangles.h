// Whether a point is in a voxel, boundary included, in one of the triangles TL-TR-BR and TL-BR-BL: x0, y0 to x3, y3 are the
// corners seen from the point, numbers or lanes of numbers.

auto in_voxel = [](auto x0, auto y0, auto x1, auto y1, auto x2, auto y2, auto x3, auto y3) {
    const auto c = x2 * y0 - y2 * x0, a = x0 * y1 - y0 * x1, b = x1 * y2 - y1 * x2;
    const auto d = x0 * y3 - y0 * x3, e = x3 * y2 - y3 * x2;
    return ((c * a >= 0.0) & (c * b >= 0.0)) | ((c * d >= 0.0) & (c * e >= 0.0));
};
