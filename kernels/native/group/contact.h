// Contacts of a sub-step: which corners are in another voxel or cell, and the forces of these contacts. The candidates are
// spread over the threads; the contacts come into a queue in the order of candidates, their forces are computed side by
// side and added in that order.

struct Quad { double x[4], y[4]; };

auto quad_of = [&](int v) -> Quad {
    Quad q;
    if (v >= 0) {
        const wp::vec_t<4, int> c = corner[v];
        UNROLL for (int k = 0; k < 4; ++k) {
            const Place p = at.pos[c[k]];
            q.x[k] = p.x;
            q.y[k] = p.y;
        }
    } else {
        const double* b = terrain_box + 4 * (-1 - v);
        q.x[0] = q.x[3] = b[0];
        q.x[1] = q.x[2] = b[1];
        q.y[2] = q.y[3] = b[2];
        q.y[0] = q.y[1] = b[3];
    }
    return q;
};
// The same in single precision: as rounding keeps the order of numbers, a corner that is not in the rounded box is not in
// the voxel.
auto near_of = [&](int v, Near* q) {
    if (v >= 0) {
        const wp::vec_t<4, int> c = corner[v];
        UNROLL for (int k = 0; k < 4; ++k) q[k] = at.touch.near[c[k]];
    } else {
        const double* b = terrain_box + 4 * (-1 - v);
        const float left = Single(b[0]), right = Single(b[1]), bottom = Single(b[2]), top = Single(b[3]);
        q[0] = Near{left, top};
        q[1] = Near{right, top};
        q[2] = Near{right, bottom};
        q[3] = Near{left, bottom};
    }
};
auto corner_at = [&](int v, int c) -> Place {
    if (v >= 0) return at.pos[corner[v][c]];
    const double* b = terrain_box + 4 * (-1 - v);
    return Place{b[c == 1 || c == 2], b[c < 2 ? 3 : 2]};
};
auto sides_of = [&](int v) -> int {
    if (v < 0) return terrain_side[-1 - v];
    const wp::vec_t<4, int> lanes = wp::index(model.side_lanes, here, v);
    return (lanes[0] & 1) | (lanes[1] & 1) << 1 | (lanes[2] & 1) << 2 | (lanes[3] & 1) << 3;
};

// Bits of the corners of i (4 on: of j) in the box of the other, and whether the boxes overlap.
auto near_corners = [&](const wp::vec_t<4, int>& pair, bool& overlap) -> unsigned {
    Near a[4], b[4];
    near_of(pair[0], a);
    near_of(pair[1], b);
    const float ax0 = least4(a[0].x, a[1].x, a[2].x, a[3].x), ax1 = most4(a[0].x, a[1].x, a[2].x, a[3].x);
    const float ay0 = least4(a[0].y, a[1].y, a[2].y, a[3].y), ay1 = most4(a[0].y, a[1].y, a[2].y, a[3].y);
    const float bx0 = least4(b[0].x, b[1].x, b[2].x, b[3].x), bx1 = most4(b[0].x, b[1].x, b[2].x, b[3].x);
    const float by0 = least4(b[0].y, b[1].y, b[2].y, b[3].y), by1 = most4(b[0].y, b[1].y, b[2].y, b[3].y);
    overlap = ax0 <= bx1 && bx0 <= ax1 && ay0 <= by1 && by0 <= ay1;
    unsigned bits = 0;
    UNROLL for (int c = 0; c < 4; ++c) {
        if (bx0 <= a[c].x && a[c].x <= bx1 && by0 <= a[c].y && a[c].y <= by1) bits |= 1u << c;
        if (ax0 <= b[c].x && b[c].x <= ax1 && ay0 <= b[c].y && b[c].y <= ay1) bits |= 16u << c;
    }
    return bits & ((pair[2] & 15) | pair[3] << 4);
};
auto within = [&](const Place& p, const Quad& r) -> bool {
    return least4(r.x[0], r.x[1], r.x[2], r.x[3]) <= p.x && p.x <= most4(r.x[0], r.x[1], r.x[2], r.x[3])
        && least4(r.y[0], r.y[1], r.y[2], r.y[3]) <= p.y && p.y <= most4(r.y[0], r.y[1], r.y[2], r.y[3])
        && in_voxel(
            r.x[0] - p.x, r.y[0] - p.y, r.x[1] - p.x, r.y[1] - p.y, r.x[2] - p.x, r.y[2] - p.y, r.x[3] - p.x, r.y[3] - p.y
        );
};

auto boxes_meet = [&](const Quad& a, const Quad& b) -> bool {
    return least4(a.x[0], a.x[1], a.x[2], a.x[3]) <= most4(b.x[0], b.x[1], b.x[2], b.x[3])
        && least4(b.x[0], b.x[1], b.x[2], b.x[3]) <= most4(a.x[0], a.x[1], a.x[2], a.x[3])
        && least4(a.y[0], a.y[1], a.y[2], a.y[3]) <= most4(b.y[0], b.y[1], b.y[2], b.y[3])
        && least4(b.y[0], b.y[1], b.y[2], b.y[3]) <= most4(a.y[0], a.y[1], a.y[2], a.y[3]);
};

// Forces of contact `code` = 8 x candidate + 4 x way + corner.
auto force_of = [&](int code, Hit& hit) {
    COUNT(contact_force);
    const wp::vec_t<4, int> pair = candidates[code >> 3];
    const int way = code >> 2 & 1, c = code & 3, i = way ? pair[1] : pair[0], j = way ? pair[0] : pair[1];
    hit.point[0] = hit.point[1] = hit.point[2] = -1;
    const Place tip = corner_at(i, c), next = corner_at(i, (c + 1) & 3), last = corner_at(i, (c + 3) & 3);
    const int m_sides = sides_of(i), r_sides = sides_of(j);
    // Inner bottom and left edges run against the clock, as they were made.
    const bool turn_next = c >= 2 && !(m_sides >> c & 1);
    const bool turn_last = ((c + 3) & 3) >= 2 && !(m_sides >> ((c + 3) & 3) & 1);
    int best = -1;
    double depth = 0.0, ux = 0.0, uy = 0.0;
    ROLL for (int e = 0; e < 4; ++e) {
        if (!(r_sides >> e & 1)) continue;
        COUNT(contact_side);
        const Place a = corner_at(j, e), b = corner_at(j, (e + 1) & 3);
        bool met = false;
        ROLL for (int edge = 0; edge < 2 && !met; ++edge) {
            COUNT(contact_edge);
            const bool turned = edge ? !turn_last : turn_next;
            const Place other = edge ? last : next;
            const Place from = turned ? other : tip, to = turned ? tip : other;
            met = crosses(from.x, from.y, to.x, to.y, a.x, a.y, b.x, b.y);
        }
        if (!met) continue;
        COUNT(contact_depth);
        const double d = depth_under(tip.x, tip.y, a.x, a.y, b.x, b.y);
        if (best < 0 || d < depth) {
            best = e;
            depth = d;
            ux = b.x - a.x;
            uy = b.y - a.y;
        }
    }
    if (best < 0) return;
    COUNT(contact_law);
    const wp::vec_t<4, int>* table = pair[1] >= 0 ? &wp::index(model.pushed, here, 0) : corner;
    if (i >= 0) hit.point[0] = table[i][c];
    if (j >= 0) {
        hit.point[1] = table[j][best];
        hit.point[2] = table[j][(best + 1) & 3];
    }
    const bool twice = i >= 0 && j >= 0 && wp::index(model.body, here, i) == wp::index(model.body, here, j);
    Place velocity[3];
    UNROLL for (int k = 0; k < 3; ++k) {
        velocity[k] = hit.point[k] < 0 ? Place{0.0, 0.0} : at.touch.velocity[hit.point[k]];
    }
    contact_law(ux, uy, depth, twice ? 2.0 : 1.0, velocity, hit.push);
};

auto add_queue = [&](int waiting) {
    COUNT(contact_queue);
    sync();
    const int longest = most(waiting);
    ROLL for (int base = 0; base < longest; base += PARTS) {
        if (base + part < waiting) force_of(at.touch.queue[base + part], at.touch.hit[part]);
        sync();
        ROLL for (int n = 0; n < PARTS && base + n < longest; ++n) {
            COUNT(contact_sum);
            const Hit& hit = at.touch.hit[n];
            const int p = part < 6 && base + n < waiting ? hit.point[part >> 1] : -1;
            if (p >= 0) {
                Real* sum = part & 1 ? &at.contact[p].y : &at.contact[p].x;
                const Push& push = hit.push[part >> 1];
                *sum = *sum + (part & 1 ? push.normal.y : push.normal.x);
                *sum = *sum + (part & 1 ? push.friction.y : push.friction.x);
            }
            sync();
        }
    }
};

// Overlapping boxes of distant voxels of a robot, in both orders; true if one has more than its limit.
auto count_folds = [&](unsigned folded, int i) {
    COUNT(folds);
    int* folds = &wp::index(data.folds, pack, 0, 0);
    if (!any_folds) {
        for (int k = part; k < wp::index(model.robots, here); k += PARTS) folds[k] = 0;
        any_folds = true;
        sync();
    }
    for (; some(folded); folded &= folded - 1) {
        if (folded && lowest(folded) == part) folds[wp::index(model.robot, here, i)] += 2;
        sync();
    }
};

auto touch = [&]() {
    int waiting = 0;
    any_folds = false;
    const int rounds = most(count);
    ROLL for (int base = 0; base < rounds; base += PARTS) {
        COUNT(candidate);
        const int n = base + part;
        unsigned inside = 0;
        int i = -1;
        bool fold = false;
        if (n < count) {
            const wp::vec_t<4, int> pair = candidates[n];
            i = pair[0];
            bool overlap;
            unsigned near = near_corners(pair, overlap);
            ROLL for (; near; near &= near - 1) {
                COUNT(near_corner);
                const int b = lowest(near), way = b >> 2;
                if (within(corner_at(way ? pair[1] : pair[0], b & 3), quad_of(way ? pair[0] : pair[1]))) inside |= 1u << b;
            }
            if (overlap && pair[2] & DISTANT) {
                COUNT(distant);
                fold = boxes_meet(quad_of(i), quad_of(pair[1]));
            }
        }
        const unsigned folded = vote(fold);
        if (some(folded)) count_folds(folded, i);
        if (!some(inside)) continue;
        COUNT(contact_found);
        int place = 0, total = 0;
        UNROLL for (int b = 0; b < 8; ++b) {
            const unsigned those = vote(inside >> b & 1);
            place += count_bits(those & ((1u << part) - 1));
            total += count_bits(those);
        }
        if (some(waiting + total > QUEUE)) {
            add_queue(waiting);
            waiting = 0;
        }
        place += waiting;
        waiting += total;
        for (; inside; inside &= inside - 1) at.touch.queue[place++] = 8 * n + lowest(inside);
    }
    if (some(waiting)) add_queue(waiting);
    if (any_folds) {
        COUNT(folds_end);
        for (int k = 0; k < wp::index(model.robots, here); ++k) {
            folded_up |= wp::index(data.folds, pack, k, 0) > wp::index(model.fold_limit, here, k, 0);
        }
    }
};
