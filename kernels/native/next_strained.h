// Body of a function (model, data, design, pack, lane, begin, rigid, bound) -> int: the first spring from `begin` on (of
// those of rigid sides: the first place in their list) whose strain is at or beyond the bound in some lane, or one past
// the last.

const int count = rigid ? wp::index(model.rigids, design) : wp::index(model.springs, design);
const int* listed = &wp::index(model.rigid_spring, design, 0);
const wp::vec_t<2, int>* spring_ends = &wp::index(model.spring_ends, design, 0);
const double* spring_rest = &wp::index(model.spring_rest, design, 0);
const auto disp = values(data.disp);
const auto span = values(data.span);
for (int n = begin; n < count; ++n) {
    const int s = rigid ? listed[n] : n;
    const unsigned a = 2 * spring_ends[s][0], b = 2 * spring_ends[s][1];
    const Value ex = span[2 * s] + (disp[b] - disp[a]), ey = span[2 * s + 1] + (disp[b + 1] - disp[a + 1]);
    const Value square = ex * ex + ey * ey;
    const Real rest = static_cast<Real>(spring_rest[s]);
    const Real longest = rest * (Real(1) + bound), shortest = rest * (Real(1) - bound);
    if (bits_of((square >= longest * longest) | (square <= shortest * shortest))) return n;
}
return count;
