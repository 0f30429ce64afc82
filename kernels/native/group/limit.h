// Strain limits on displacements, as in limit.h of the lanes. Corrections are rare: all springs are tested side by side,
// those beyond their limit are corrected one after another in the order of springs.

// A point stands in 15 bits, whether it is free in one.
auto side_of = [&](int row, int s) -> Side {
    const wp::vec_t<2, int> ends = wp::index(model.spring_ends, row, s);
    const int* free_lanes = row_of(model.free_lanes, row);
    const unsigned first = ends[0] | (free_lanes[ends[0]] ? FREE : 0), second = ends[1] | (free_lanes[ends[1]] ? FREE : 0);
    return Side{first | second << 16, Real(wp::index(model.spring_rest, row, s))};
};
unsigned rigid_rounds = 0;
auto load_rigids = [&]() {
    at.rigid[part] = part < rigids ? side_of(mesh, wp::index(model.rigid_spring, mesh, part)) : Side{0, Real(0)};
    const int bits = (most(rigids) + PARTS * ROUNDS_A_BIT - 1) / (PARTS * ROUNDS_A_BIT);
    rigid_rounds = bits ? ~0u >> (32 - bits) : 0;
};

// Corrects those springs (of all, or of the `rigids` listed in `rigid_spring`) that are beyond the bound, in their order: in
// `moved`, and where `in_place` in the displacements, too, after which those behind it are tested again. `rounds`: a bit
// for ROUNDS_A_BIT rounds of springs in which one may be beyond.
auto correct = [&](bool in_place, unsigned rounds) {
    const int total = in_place ? rigids : springs;
    const Real bound = in_place ? model.rigid_strain_limit : model.strain_limit;
    const Real share = in_place ? model.rigid_strain_share : model.strain_share;
    bool any = false;
    ROLL for (int round = 0; rounds; round = (round + 1) % ROUNDS_A_BIT, rounds &= round ? rounds : rounds - 1) {
        const int n = PARTS * (ROUNDS_A_BIT * lowest(rounds) + round) + part;
        Side side{0, Real(0)};
        if (in_place && n < PARTS) {
            side = at.rigid[part];
        } else if (n < total) {
            int row = mesh;
            HIDE(row);
            side = side_of(row, in_place ? wp::index(model.rigid_spring, row, n) : n);
        }
        const int p = side.ends & (FREE - 1), q = side.ends >> 16 & (FREE - 1);
        const Real dx = Real(at.pos[q].x - at.pos[p].x), dy = Real(at.pos[q].y - at.pos[p].y), rest0 = side.rest;
        const Real longest = rest0 * (Real(1) + bound), shortest = rest0 * (Real(1) - bound);
        int from = 0, again = 1;
        ROLL while (again) {
            const Pair a = at.disp[p], b = at.disp[q];
            const Real ex = dx + (b.x - a.x), ey = dy + (b.y - a.y), square = ex * ex + ey * ey;
            const bool beyond = square >= longest * longest || square <= shortest * shortest;
            bool found;
            const int next = first_of(beyond && part >= from && n < total, found);
            again = found;
            HIDE(again);
            if (!found) continue;
            if (!any) {
                own_points([&](int, int own) { at.moved[own] = Pair{Real(0), Real(0)}; });
                any = true;
                sync();
            }
            if (next == part) {
                const Real length = nearest_root(square), over = length - longest, under = length - shortest;
                const Real excess = (over > Real(0) ? over : Real(0)) + (under < Real(0) ? under : Real(0));
                const Real portion = quotient(excess * (Real(0.5) * share), length), x = ex * portion, y = ey * portion;
                auto shift = [&](int own, Real sx, Real sy) {
                    at.moved[own] = Pair{at.moved[own].x + sx, at.moved[own].y + sy};
                    if (in_place) at.disp[own] = Pair{at.disp[own].x + sx, at.disp[own].y + sy};
                };
                if (side.ends & FREE) shift(p, x, y);
                if (side.ends >> 16 & FREE) shift(q, -x, -y);
            }
            from = next + 1;
            sync();
        }
    }
    if (!any) return;
    own_points([&](int j, int p) {
        const Pair c = at.moved[p];
        if (!in_place) at.disp[p] = Pair{at.disp[p].x + c.x, at.disp[p].y + c.y};
        move[j][0] = move[j][0] + double(c.x);
        move[j][1] = move[j][1] + double(c.y);
    });
    sync();
};

// Squares of lengths within the bound are this near their middle, as a share of it. With room for rounding: what seems to
// be beyond the bound is tested once more by `correct`.
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
    ROLL for (int pass = beyond ? 0 : 1; pass < 2; ++pass) {
        HIDE(pass);
        correct(pass != 0, pass ? rigid_rounds : beyond);
    }
};
