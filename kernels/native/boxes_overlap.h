// Body of a function (one, i, other, j, pack, lane) -> int: the lanes in which the boxes of row i of one table and row j of
// another overlap or touch. Mostly one side can tell.

const auto a = wides(one), b = wides(other);
int lanes = bits_of(a[4 * i + 2] <= b[4 * j + 3]);
if (lanes) lanes &= bits_of(b[4 * j + 2] <= a[4 * i + 3]);
if (lanes) lanes &= bits_of(a[4 * i] <= b[4 * j + 1]);
if (lanes) lanes &= bits_of(b[4 * j] <= a[4 * i + 1]);
return lanes;
