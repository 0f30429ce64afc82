// Strain limits on displacements, as in limit.h of the lanes. Corrections are rare: all springs are tested side by side, those beyond
// their limit are corrected one after another in the order of springs.

auto own_points = [&](auto&& act) {
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        if (POINT_ROUNDS <= FEW || PARTS * j < points) act(j, part + PARTS * j);
    }
};

auto side_of = [&](int row, int s) -> Side {
    const wp::vec_t<2, int> ends = wp::index(model.spring_ends, row, s);
    return Side{unsigned(ends[0] | ends[1] << 16), Real(wp::index(model.spring_rest, row, s))};
};
auto load_rigids = [&]() { at.rigid[part] = part < rigids ? side_of(mesh, wp::index(model.rigid_spring, mesh, part)) : Side{0, Real(0)}; };

// Corrects those of `total` springs (of all, or listed in `rigid_spring`) that are beyond the bound, in their order: in
// `moved`, and where `in_place` in the displacements, too, after which those behind it are tested anew.
auto correct = [&](bool in_place) {
    const int total = in_place ? rigids : springs, longest_list = most(total);
    const Real bound = in_place ? model.rigid_strain_limit : model.strain_limit;
    const Real share = in_place ? model.rigid_strain_share : model.strain_share;
    bool any = false;
    COUNT(limit_pass);
    ROLL for (int base = 0; base < longest_list; base += PARTS) {
        COUNT(limit_test);
        HIDE(base);
        const int n = base + part;
        Side side{0, Real(0)};
        if (in_place && base == 0) {
            side = at.rigid[part];
        } else if (n < total) {
            int row = mesh;
            HIDE(row);
            side = side_of(row, in_place ? wp::index(model.rigid_spring, row, n) : n);
        }
        const int p = side.ends & 0xffff, q = side.ends >> 16;
        const Real dx = Real(at.pos[q].x - at.pos[p].x), dy = Real(at.pos[q].y - at.pos[p].y), rest0 = side.rest;
        const Real longest = rest0 * (Real(1) + bound), shortest = rest0 * (Real(1) - bound);
        ROLL for (int from = 0; from < PARTS;) {
            COUNT(limit_try);
            const Pair a = at.disp[p], b = at.disp[q];
            const Real ex = dx + (b.x - a.x), ey = dy + (b.y - a.y), square = ex * ex + ey * ey;
            const bool beyond = square >= longest * longest || square <= shortest * shortest;
            const unsigned those = vote(beyond && part >= from && n < total);
            if (!some(those)) break;
            COUNT(limit_correct);
            if (!any) {
                COUNT(limit_begin);
                own_points([&](int, int own) { at.moved[own] = Pair{Real(0), Real(0)}; });
                any = true;
                sync();
            }
            const int next = those ? lowest(those) : PARTS;
            if (next == part) {
                const Real length = wp::sqrt(square), over = length - longest, under = length - shortest;
                const Real excess = (over > Real(0) ? over : Real(0)) + (under < Real(0) ? under : Real(0));
                const Real portion = excess * (Real(0.5) * share) / length;
                ROLL for (int end = 0; end < 2; ++end) {
                    const int own = end ? q : p;
                    const Real x = end ? -(ex * portion) : ex * portion, y = end ? -(ey * portion) : ey * portion;
                    if (!wp::index(model.free_lanes, mesh, own)) continue;
                    at.moved[own] = Pair{at.moved[own].x + x, at.moved[own].y + y};
                    if (in_place) at.disp[own] = Pair{at.disp[own].x + x, at.disp[own].y + y};
                }
            }
            from = next + 1;
            sync();
        }
    }
    if (!any) return;
    COUNT(limit_end);
    own_points([&](int j, int p) {
        const Pair c = at.moved[p];
        if (!in_place) at.disp[p] = Pair{at.disp[p].x + c.x, at.disp[p].y + c.y};
        move[j][0] = move[j][0] + double(c.x);
        move[j][1] = move[j][1] + double(c.y);
    });
    sync();
};

auto limit_strain = [&]() {
    bool beyond = false;
    EACH_SPRING for (int j = 0; j < SPRING_ROUNDS; ++j) {
        if (SPRING_ROUNDS > FEW && PARTS * j >= springs) break;
        COUNT(limit);
        const Spring spring = at.spring[part + PARTS * j];
        const Pair a = at.disp[spring.ends & 0xffff], b = at.disp[spring.ends >> 16];
        const Real ex = vec[j].x + (b.x - a.x), ey = vec[j].y + (b.y - a.y), square = ex * ex + ey * ey;
        beyond |= square >= spring.longest || square <= spring.shortest;
    }
    int first = some(beyond) ? 0 : 1;
    HIDE(first);
    ROLL for (int pass = first; pass < 2; ++pass) {
        HIDE(pass);
        correct(pass != 0);
    }
};
