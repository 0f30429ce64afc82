// Strain limits on displacements, as in limit.h of the lanes.

// A point stands in the lower bits of an end, whether it is free in one above them; of the first end of a rigid side there
// is one more, whether the side is the last of its level.
auto side_of = [&](int row, int s) -> Side {
    const wp::vec_t<2, int> ends = wp::index(model.spring_ends, row, s);
    const int* free_lanes = row_of(model.free_lanes, row);
    const unsigned first = ends[0] | (free_lanes[ends[0]] ? FREE : 0), second = ends[1] | (free_lanes[ends[1]] ? FREE : 0);
    return Side{first | second << 16, Real(wp::index(model.spring_rest, row, s))};
};
auto load_rigids = [&]() {
    const int* rigid_spring = row_of(model.rigid_spring, mesh);
    for (int n = part; n < RIGIDS; n += PARTS) {
        const int s = n < rigids ? rigid_spring[n] : 0;
        at.rigid[n] = n < rigids ? side_of(mesh, s < 0 ? -1 - s : s) : Side{0, Real(0)};
        if (s < 0) at.rigid[n].ends |= LAST;
    }
};

// Whether a side is beyond the bound, and by how much its first end is moved then: toward the second where it is too long.
auto correction = [&](const Side& side, Real bound, Real share, Pair& by) -> bool {
    const int p = side.ends & POINT, q = side.ends >> 16 & POINT;
    const Real dx = Real(at.pos[q].x - at.pos[p].x), dy = Real(at.pos[q].y - at.pos[p].y);
    const Real longest = side.rest * (Real(1) + bound), shortest = side.rest * (Real(1) - bound);
    const Pair a = at.disp[p], b = at.disp[q];
    const Real ex = dx + (b.x - a.x), ey = dy + (b.y - a.y), square = ex * ex + ey * ey;
    if (!(square >= longest * longest || square <= shortest * shortest)) return false;
    const Real length = nearest_root(square), over = length - longest, under = length - shortest;
    const Real excess = (over > Real(0) ? over : Real(0)) + (under < Real(0) ? under : Real(0));
    const Real portion = quotient(excess * (Real(0.5) * share), length);
    by = Pair{ex * portion, ey * portion};
    return true;
};
// Moves the ends of a side that are free.
auto shift = [](Pair* pairs, const Side& side, Pair by) {
    const int p = side.ends & POINT, q = side.ends >> 16 & POINT;
    const Pair a = pairs[p], b = pairs[q];
    if (side.ends & FREE) pairs[p] = Pair{a.x + by.x, a.y + by.y};
    if (side.ends >> 16 & FREE) pairs[q] = Pair{b.x - by.x, b.y - by.y};
};
auto clear_moved = [&]() {
    own_points([&](int, int p) { at.moved[p] = Pair{Real(0), Real(0)}; });
    sync();
};

// The first pass: springs beyond their bound, all from one snapshot, are corrected one after another in their order.
// `rounds`: a bit for ROUNDS_A_BIT rounds of springs in which one may be beyond.
auto correct_springs = [&](unsigned rounds) {
    bool any = false;
    ROLL for (int round = 0; rounds; round = (round + 1) % ROUNDS_A_BIT, rounds &= round ? rounds : rounds - 1) {
        const int n = PARTS * (ROUNDS_A_BIT * lowest(rounds) + round) + part;
        Side side{0, Real(0)};
        Pair by{Real(0), Real(0)};
        bool beyond = false;
        if (n < springs) {
            int row = mesh;
            HIDE(row);
            side = side_of(row, n);
            beyond = correction(side, model.strain_limit, model.strain_share, by);
        }
        ROLL for (bool found = true; found;) {
            const int next = first_of(beyond, found);
            if (!found) continue;
            if (!any) clear_moved();
            any = true;
            if (next == part) shift(at.moved, side, by);
            beyond &= next != part;
            sync();
        }
    }
    if (!any) return;
    own_points([&](int j, int p) {
        const Pair c = at.moved[p];
        at.disp[p] = Pair{at.disp[p].x + c.x, at.disp[p].y + c.y};
        move[j][0] = move[j][0] + double(c.x);
        move[j][1] = move[j][1] + double(c.y);
    });
    sync();
};

// The second pass: the sides of rigid voxels, in place, level by level. Levels are many and narrow: the first warp goes
// through them without the others. Of as many sides as it has threads, whatever their levels, it corrects those of the first
// level in which one is beyond the bound, and goes on behind that level.
auto correct_rigids = [&]() {
    if (!some(at.rigid[0].ends)) return;
    clear_moved();
    bool any = false;
    ROLL for (int first = 0; !TIGHT || part < 32;) {
        const int n = first + part;
        const Side side = (TIGHT || part < WHOLE) && n < RIGIDS ? at.rigid[n] : Side{0, Real(0)};
        if (!some_of_warp(side.ends)) break;
        Pair by;
        const bool beyond = side.ends && correction(side, model.rigid_strain_limit, model.rigid_strain_share, by);
        const int begin = first_of_warp(beyond), end = first_of_warp(part >= begin && side.ends & LAST);
        if (beyond && part <= end) {
            shift(at.disp, side, by);
            shift(at.moved, side, by);
            any = true;
        }
        first += wp::min(end + 1, WHOLE);
        sync_first_warp();
    }
    if (!some(any)) return;
    own_points([&](int j, int p) {
        const Pair c = at.moved[p];
        move[j][0] = move[j][0] + double(c.x);
        move[j][1] = move[j][1] + double(c.y);
    });
    sync();
};

// Squares of lengths within the bound are this near their middle, as a share of it. With room for rounding: what seems to
// be beyond the bound is tested once more by `correct_springs`.
const Real strain_reach = Real(2) * model.strain_limit / (Real(1) + model.strain_limit * model.strain_limit) - Real(2e-6);

auto limit_strain = [&]() {
    unsigned beyond = 0;
    EACH_SPRING for (int j = 0; j < SPRING_ROUNDS; ++j) {
        if (!within(j, SPRINGS) || SPRING_ROUNDS > FEW && PARTS * j >= springs) break;
        const unsigned ends = at.spring[part + PARTS * j].ends;
        const Real middle = at.length[part + PARTS * j].middle;
        const Pair a = pair_at(at.disp, ends & 0xffff), b = pair_at(at.disp, ends >> 16);
        const Real ex = vec[j].x + (b.x - a.x), ey = vec[j].y + (b.y - a.y);
        if (wp::abs(fused(ex, ex, fused(ey, ey, -middle))) >= middle * strain_reach) beyond |= 1u << j / ROUNDS_A_BIT;
    }
    beyond = together(beyond);
    if (beyond) correct_springs(beyond);
    correct_rigids();
};
