// Contacts of a sub-step: which corners are in another voxel or cell, and the forces of these contacts. The candidates are
// spread over the threads; the contacts come into a queue in the order of candidates, the first warp computes their forces
// side by side and adds them in that order.

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
auto corner_at = [&](int v, int c) -> Place {
    if (v >= 0) return at.pos[corner[v][c]];
    const double* b = terrain_box + 4 * (-1 - v);
    return Place{b[(c ^ c >> 1) & 1], b[3 - (c >> 1)]};  // from the top left on, clockwise
};
struct Box { double left, right, bottom, top; };
auto box_of = [&](const Quad& q, double margin) -> Box {
    return Box{
        least4(q.x[0], q.x[1], q.x[2], q.x[3]) - margin, most4(q.x[0], q.x[1], q.x[2], q.x[3]) + margin,
        least4(q.y[0], q.y[1], q.y[2], q.y[3]) - margin, most4(q.y[0], q.y[1], q.y[2], q.y[3]) + margin
    };
};
auto holds = [](const Box& b, double x, double y) -> bool { return b.left <= x && x <= b.right && b.bottom <= y && y <= b.top; };
// The corners of a voxel seen from a point, and whether the point is within their bounds: differences tell by their sign.
auto seen_from = [&](const Place& p, const Quad& q) -> Quad {
    Quad seen;
    UNROLL for (int k = 0; k < 4; ++k) {
        seen.x[k] = q.x[k] - p.x;
        seen.y[k] = q.y[k] - p.y;
    }
    return seen;
};
auto around = [&](const Quad& seen) -> bool {
    int x[4], y[4];
    UNROLL for (int k = 0; k < 4; ++k) {
        x[k] = sign_of(seen.x[k]);
        y[k] = sign_of(seen.y[k]);
    }
    const int low_x = least4(x[0], x[1], x[2], x[3]), high_x = most4(x[0], x[1], x[2], x[3]);
    const int low_y = least4(y[0], y[1], y[2], y[3]), high_y = most4(y[0], y[1], y[2], y[3]);
    return (low_x <= 0) & (high_x >= 0) & (low_y <= 0) & (high_y >= 0);
};
auto boxes_overlap = [](const Box& a, const Box& b) -> bool {
    return a.left <= b.right && b.left <= a.right && a.bottom <= b.top && b.bottom <= a.top;
};

// Forces of contact `code` = 8 x candidate + 4 x way + corner.
auto force_of = [&](int code, Hit& hit) {
    const wp::vec_t<4, int> pair = candidates[code >> 3];
    const int way = code >> 2 & 1, c = code & 3, i = way ? pair[1] : pair[0], j = way ? pair[0] : pair[1];
    hit.point[0] = hit.point[1] = hit.point[2] = -1;
    const Place tip = corner_at(i, c), next = corner_at(i, (c + 1) & 3), last = corner_at(i, (c + 3) & 3);
    const int* terrain_side = row_of(model.terrain_side, frame);
    const wp::vec_t<4, int>* side_lanes = row_of(model.side_lanes, here);
    auto sides_of = [&](int v) -> int {
        if (v < 0) return terrain_side[-1 - v];
        const wp::vec_t<4, int> lanes = side_lanes[v];
        return (lanes[0] & 1) | (lanes[1] & 2) | (lanes[2] & 4) | (lanes[3] & 8);
    };
    const int m_sides = sides_of(i), r_sides = sides_of(j);
    // Inner bottom and left edges run against the clock, as they were made.
    const bool turn_next = c >= 2 && !(m_sides >> c & 1);
    const bool turn_last = ((c + 3) & 3) >= 2 && !(m_sides >> ((c + 3) & 3) & 1);
    int best = -1;
    double depth = 0.0, ux = 0.0, uy = 0.0;
    ROLL for (int e = 0; e < 4; ++e) {
        if (!(r_sides >> e & 1)) continue;
        const Place a = corner_at(j, e), b = corner_at(j, (e + 1) & 3);
        bool met = false;
        ROLL for (int edge = 0; edge < 2 && !met; ++edge) {
            const bool turned = edge ? !turn_last : turn_next;
            const Place other = edge ? last : next;
            const Place from = turned ? other : tip, to = turned ? tip : other;
            met = crosses(from.x, from.y, to.x, to.y, a.x, a.y, b.x, b.y);
        }
        if (!met) continue;
        const double d = depth_under(tip.x, tip.y, a.x, a.y, b.x, b.y);
        if (best < 0 || d < depth) {
            best = e;
            depth = d;
            ux = b.x - a.x;
            uy = b.y - a.y;
        }
    }
    if (best < 0) return;
    const wp::vec_t<4, int>* pushed = row_of(model.pushed, here);  // what never moves may have no room in `contact`
    if (i >= 0) hit.point[0] = pushed[i][c];
    if (j >= 0) {
        hit.point[1] = pushed[j][best];
        hit.point[2] = pushed[j][(best + 1) & 3];
    }
    const int* body = row_of(model.body, here);
    const bool twice = i >= 0 && j >= 0 && body[i] == body[j];
    Place velocity[3];
    UNROLL for (int k = 0; k < 3; ++k) {
        velocity[k] = hit.point[k] < 0 ? Place{0.0, 0.0} : at.touch.velocity[hit.point[k]];
    }
    contact_law(model.contact, ux, uy, depth, twice ? 2.0 : 1.0, velocity, hit.push);
};

auto add_queue = [&](int waiting) {
    sync();
    const int longest = most(waiting);
    ROLL for (int base = 0; base < longest; base += WHOLE) {
        if (part < WHOLE && base + part < waiting) force_of(at.touch.queue[base + part], at.touch.hit[part]);
        sync();
        const int end = TIGHT && WARPS > 1 && part >= 32 ? 0 : WHOLE;  // six threads of the first warp add
        ROLL for (int n = 0; n < end && base + n < longest; ++n) {
            const Hit& hit = at.touch.hit[n];
            const int p = part < 6 && base + n < waiting ? hit.point[part >> 1] : -1;
            if (p >= 0) {
                Real* sum = part & 1 ? &at.contact[p].y : &at.contact[p].x;
                const Push& push = hit.push[part >> 1];
                *sum = *sum + (part & 1 ? push.normal.y : push.normal.x);
                *sum = *sum + (part & 1 ? push.friction.y : push.friction.x);
            }
            sync_first_warp();
        }
        if (WARPS > 1) sync();
    }
};

// Counts overlapping boxes of distant voxels of a robot, in both orders.
auto count_folds = [&](bool fold, int i) {
    int* folds = &wp::index(data.folds, pack, 0, 0);
    if (!any_folds) {
        for (int k = part; k < wp::index(model.robots, here); k += PARTS) folds[k] = 0;
        any_folds = true;
        sync();
    }
    for (bool any = true; any;) {
        if (first_of(fold, any) == part) {
            folds[wp::index(model.robot, here, i)] += 2;
            fold = false;
        }
        sync();
    }
};

// The corners that may be in another voxel before a point has moved by half of CLOSE_MARGIN, as codes in ascending order.
// More than CLOSE: they, or the candidates, are too many for the list, and all corners of candidates are tested.
auto find_close = [&]() {
    const int rounds = most(count);
    close_count = 0;
    bool folding = false;
    ROLL for (int base = 0; base < rounds; base += PARTS) {
        const int n = base + part;
        unsigned near = 0;
        if (n < count) {
            const wp::vec_t<4, int> pair = candidates[n];
            const Quad a = quad_of(pair[0]), b = quad_of(pair[1]);
            const Box around_a = box_of(a, CLOSE_MARGIN), around_b = box_of(b, CLOSE_MARGIN);
            UNROLL for (int c = 0; c < 4; ++c) {
                if (holds(around_b, a.x[c], a.y[c])) near |= 1u << c;
                if (holds(around_a, b.x[c], b.y[c])) near |= 16u << c;
            }
            near &= (pair[2] & 15) | pair[3] << 4;
            folding |= pair[2] & DISTANT && boxes_overlap(around_a, around_b);
        }
        if (!some(near)) continue;
        int total, place = close_count + sum_before(count_bits(near), total);
        close_count += total;
        for (; near; near &= near - 1, ++place) {
            if (place < CLOSE) at.close[place] = 8 * n + lowest(near);
        }
    }
    if (count > CODED) close_count = CLOSE + 1;
    status = (status & ~FOLDING) | (some_of_group(folding) ? FOLDING : 0);
    sync();
};

auto look_for_folds = [&]() {
    const int rounds = most(pair_count);
    ROLL for (int base = 0; base < rounds; base += PARTS) {
        const int n = base + part;
        int i = -1;
        bool fold = false;
        if (n < pair_count && count) {
            const wp::vec_t<4, int> pair = candidates[n];
            i = pair[0];
            fold = pair[2] & DISTANT && boxes_overlap(box_of(quad_of(i), 0.0), box_of(quad_of(pair[1]), 0.0));
        }
        if (some(fold)) count_folds(fold, i);
    }
    for (int k = 0; any_folds && k < wp::index(model.robots, here); ++k) {
        if (wp::index(data.folds, pack, k, 0) > wp::index(model.fold_limit, here, k, 0)) status |= UNSTABLE;
    }
};

auto touch = [&]() {
    int waiting = 0;
    any_folds = false;
    if (some(near_drift + near_drift >= Single(CLOSE_MARGIN))) {
        find_close();
        near_drift = 0.0f;
    }
    if (some(status & FOLDING)) look_for_folds();
    const bool crowded = close_count > CLOSE;
    const int total = crowded ? 8 * count : close_count, rounds = most(total);
    ROLL for (int base = 0; base < rounds; base += PARTS) {
        const int n = base + part;
        bool inside = false;
        int code = 0;
        if (n < total) {
            code = crowded ? n : at.close[n];
            const wp::vec_t<4, int> pair = candidates[code >> 3];
            const int way = code >> 2 & 1, c = code & 3;
            if (!crowded || (way ? pair[3] : pair[2]) >> c & 1) {
                const Quad q = seen_from(corner_at(way ? pair[1] : pair[0], c), quad_of(way ? pair[0] : pair[1]));
                if (around(q)) inside = in_voxel(q.x[0], q.y[0], q.x[1], q.y[1], q.x[2], q.y[2], q.x[3], q.y[3]);
            }
        }
        bool found;
        int more;
        const int rank = rank_of(inside, more, found);
        if (!found) continue;
        if (some(waiting + PARTS > QUEUE)) {
            add_queue(waiting);
            waiting = 0;
        }
        if (inside) at.touch.queue[waiting + rank] = code;
        waiting += more;
    }
    if (some(waiting)) add_queue(waiting);
};
