// Strain limits on displacements, as in strain.h. Corrections are rare: all springs are tested side by side, those beyond
// their limit are corrected one after another in the order of springs.

auto own_points = [&](auto&& act) {
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        if (POINT_ROUNDS <= FEW || PARTS * j < points) act(j, part + PARTS * j);
    }
};

// Corrects those of `total` springs (of all, or listed in `rigid_spring`) that are beyond the bound, in their order: in
// `moved`, and where `in_place` in the displacements, too, after which those behind it are tested anew.
auto correct = [&](bool in_place) {
    int row = mesh;
    HIDE(row);
    const int* listed = row_of(model.rigid_spring, row);
    const int* free_lanes = row_of(model.free_lanes, row);
    const wp::vec_t<2, int>* spring_ends = row_of(model.spring_ends, row);
    const double* spring_rest = row_of(model.spring_rest, row);
    const int total = in_place ? rigids : springs, longest_list = most(total);
    const Real bound = in_place ? model.rigid_strain_limit : model.strain_limit;
    const Real share = in_place ? model.rigid_strain_share : model.strain_share;
    bool any = false;
    ROLL for (int base = 0; base < longest_list; base += PARTS) {
        COUNT(limit_test);
        const int n = base + part, s = n < total ? (in_place ? listed[n] : n) : 0;
        const int p = spring_ends[s][0], q = spring_ends[s][1];
        const Real dx = Real(at.pos[q].x - at.pos[p].x), dy = Real(at.pos[q].y - at.pos[p].y), rest0 = Real(spring_rest[s]);
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
                    if (!free_lanes[own]) continue;
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
        const Real ex = span[j].x + (b.x - a.x), ey = span[j].y + (b.y - a.y), square = ex * ex + ey * ey;
        beyond |= square >= spring.longest || square <= spring.shortest;
    }
    ROLL for (int pass = some(beyond) ? 0 : 1; pass < 2; ++pass) correct(pass);
};
