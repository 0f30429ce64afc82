// Body of a function (places, pack, k, c) -> quad: the points c of a lane. Constant places: with a loop over them it would go
// through memory, twice.

const double* at = &wp::index(places, pack, 0, k);
const size_t gap = places.strides[1] / sizeof(double);
wp::vec_t<8, double> q;
q[0] = at[2 * c[0] * gap];
q[1] = at[(2 * c[0] + 1) * gap];
q[2] = at[2 * c[1] * gap];
q[3] = at[(2 * c[1] + 1) * gap];
q[4] = at[2 * c[2] * gap];
q[5] = at[(2 * c[2] + 1) * gap];
q[6] = at[2 * c[3] * gap];
q[7] = at[(2 * c[3] + 1) * gap];
return q;
