// Candidates: pairs of voxels, then voxels with cells of the terrain, that may meet while no point has moved further than
// half the margin; in ascending order. An entry holds i, j and which corners of i and of j are tested; the cell c of the
// terrain stands as -1 - c.

auto least4 = [](auto a, auto b, auto c, auto d) {
    a = b < a ? b : a;
    c = d < c ? d : c;
    return c < a ? c : a;
};
auto most4 = [](auto a, auto b, auto c, auto d) {
    a = b > a ? b : a;
    c = d > c ? d : c;
    return c > a ? c : a;
};
struct alignas(16) Bounds { Single left, right, bottom, top; };  // of a voxel, the margin added on the right and on top
int here = mesh, frame = 0;
const wp::vec_t<4, int>* corner = nullptr;
wp::vec_t<4, int>* candidates = nullptr;
const double* terrain_box = nullptr;

auto load_tables = [&]() {
    if (part) return;
    const int terrain = wp::index(model.frame, mesh);
    const double* box = state_of(model.terrain_box, terrain);
    at.tables = Tables{row_of(model.corner, mesh), row_of(data.pairs, pack), box, terrain};
};
auto find_tables = [&]() {
    here = mesh;
    HIDE(here);
    const Tables tables = at.tables;
    corner = tables.corner;
    candidates = tables.candidates;
    terrain_box = tables.terrain_box;
    frame = tables.frame;
    GLOBAL(corner);
    GLOBAL(candidates);
    GLOBAL(terrain_box);
};

auto collect = [&]() {
    const int* terrain_side = row_of(model.terrain_side, frame);
    const int columns = wp::index(model.terrain, frame)[0], lattice_rows = wp::index(model.terrain, frame)[1];
    const int first_other = wp::index(model.first_other, here);
    const int* movable = row_of(model.movable, here);
    const int* fixed = row_of(model.fixed_voxel, here);
    const int* fixed_at = row_of(model.fixed_at, frame);
    double* box = &wp::index(data.box, pack, 0, 0);
    int* bits = &wp::index(data.pair_bit, pack, 0);
    const bool idle = status & (DIVERGED | STILL);
    const int voxels = idle ? 0 : wp::index(model.voxels, here), movables = idle ? 0 : wp::index(model.movables, here);
    const int words = (voxels + 31) / 32;
    const double margin = model.margin;

    ROLL for (int v = part; v < voxels; v += PARTS) {
        const wp::vec_t<4, int> c = corner[v];
        const Place a = at.pos[c[0]], b = at.pos[c[1]], d = at.pos[c[2]], e = at.pos[c[3]];
        box[4 * v] = least4(a.x, b.x, d.x, e.x);
        box[4 * v + 1] = most4(a.x, b.x, d.x, e.x);
        box[4 * v + 2] = least4(a.y, b.y, d.y, e.y);
        box[4 * v + 3] = most4(a.y, b.y, d.y, e.y);
    }
    sync();
    auto mark = [&](int i, int j) { set_bits(&bits[i * words + j / 32], 1 << (j % 32)); };
    auto meet = [&](const double* a, const double* b) -> bool {
        return a[0] <= b[1] + margin && b[0] <= a[1] + margin && a[2] <= b[3] + margin && b[2] <= a[3] + margin;
    };
    // Columns and rows of the lattice under a voxel's box with the margin; none where it is not finite.
    auto lattice = [&](int v, int* range) {
        const double x0 = box[4 * v] - margin, x1 = box[4 * v + 1] + margin;
        const double y0 = box[4 * v + 2] - margin, y1 = box[4 * v + 3] + margin;
        range[0] = range[2] = 0;
        range[1] = range[3] = -1;
        if (!(x0 > -FARTHEST && x1 < FARTHEST && y0 > -FARTHEST && y1 < FARTHEST)) return;
        const double scale = 1.0 / VOXEL, slack = 1.0e-3;
        range[0] = wp::max(static_cast<int>(wp::floor(x0 * scale - slack)), 0);
        range[1] = wp::min(static_cast<int>(wp::floor(x1 * scale + slack)), columns - 1);
        range[2] = wp::max(static_cast<int>(wp::floor(y0 * scale - slack)), 0);
        range[3] = wp::min(static_cast<int>(wp::floor(y1 * scale + slack)), lattice_rows - 1);
    };

    // Pairs of voxels that move: each with those up to half a circle of them ahead, so that all threads have as many. Most do
    // not meet, which bounds in float32 tell.
    Bounds* bounds = reinterpret_cast<Bounds*>(&wp::index(data.hull, pack, 0));
    ROLL for (int a = part; a < movables; a += PARTS) {
        const double* own = box + 4 * movable[a];
        auto reach = [](double x) -> Single { return 1e-6f + 1e-6f * wp::abs(Single(x)); };  // more than rounding
        bounds[a] = Bounds{
            Single(own[0]) - reach(own[0]), Single(own[1] + margin) + reach(own[1]),
            Single(own[2]) - reach(own[2]), Single(own[3] + margin) + reach(own[3])
        };
    }
    sync();
    int a = part, ahead = 1;
    for (int n = part; n < movables * (movables - 1) / 2; n += PARTS, a += PARTS) {
        for (; a >= movables; a -= movables) ++ahead;
        const int b = a + ahead < movables ? a + ahead : a + ahead - movables;
        const Bounds mine = bounds[a], other = bounds[b];
        if (mine.left > other.right || other.left > mine.right || mine.bottom > other.top || other.bottom > mine.top) continue;
        const int i = movable[wp::min(a, b)], j = movable[wp::max(a, b)];
        if (!(fixed[i] && fixed[j]) && meet(box + 4 * i, box + 4 * j)) mark(i, j);
    }
    // Fixed voxels; where they come first, several threads mark pairs in their rows.
    for (int a = part; a < movables && movables < voxels; a += PARTS) {
        const int v = movable[a];
        int range[4];
        lattice(v, range);
        for (int y = range[2]; y <= range[3]; ++y) {
            for (int x = range[0]; x <= range[1]; ++x) {
                const int other = fixed_at[y * columns + x], w = first_other + other;
                if (other >= 0 && !fixed[v] && meet(box + 4 * w, box + 4 * v)) mark(wp::min(v, w), wp::max(v, w));
            }
        }
    }
    sync();

    const int capacity = static_cast<int>(data.pairs.shape[1]);
    int found = 0;
    bool full = false;
    // Room for `own` entries of every thread, in the order of threads; where those of this one begin.
    auto place = [&](int own) -> int {
        int total;
        const int begin = found + sum_before(own, total);
        found += total;
        return begin;
    };
    auto own_corners = [&](const wp::vec_t<4, int>& mine, const wp::vec_t<4, int>& other) -> int {
        int own = 0;
        for (int c = 0; c < 4; ++c) {
            if (mine[c] != other[0] && mine[c] != other[1] && mine[c] != other[2] && mine[c] != other[3]) own |= 1 << c;
        }
        return own;
    };
    const int all_words = most(voxels * words), all_mobiles = most(movables);
    ROLL for (int base = 0; base < all_words; base += PARTS) {
        const int word = base + part;
        unsigned left = word < voxels * words ? unsigned(bits[word]) : 0;
        if (left) bits[word] = 0;
        if (!some(left != 0)) continue;
        int n = place(count_bits(left));
        for (; left; left &= left - 1, ++n) {
            const int i = word / words, j = 32 * (word % words) + lowest(left);
            if (n >= capacity) {
                full = true;
                break;
            }
            int own = own_corners(corner[i], corner[j]);
            const wp::vec_t<2, int> a = wp::index(model.grid, here, i), b = wp::index(model.grid, here, j);
            if (wp::index(model.robot, here, i) >= 0 && wp::index(model.body, here, i) == wp::index(model.body, here, j)
                && (wp::abs(a[0] - b[0]) > 1 || wp::abs(a[1] - b[1]) > 1)) {
                own |= DISTANT;
            }
            candidates[n] = wp::vec_t<4, int>(i, j, own, own_corners(corner[j], corner[i]));
        }
    }
    found = wp::min(found, capacity);
    pair_count = found;
    ROLL for (int base = 0; base < all_mobiles; base += PARTS) {
        const int v = base + part < movables ? movable[base + part] : -1;
        int range[4] = {0, -1, 0, -1}, own = 0;
        if (v >= 0 && !fixed[v]) lattice(v, range);  // nothing moves where both are fixed
        for (int y = range[2]; y <= range[3]; ++y) {
            for (int x = range[0]; x <= range[1]; ++x) own += terrain_side[y * columns + x] != 0;
        }
        own = wp::min(own, capacity);
        int n = place(own);
        for (int y = range[2]; y <= range[3] && n < capacity; ++y) {
            for (int x = range[0]; x <= range[1] && n < capacity; ++x) {
                const int cell = y * columns + x;
                if (terrain_side[cell]) candidates[n++] = wp::vec_t<4, int>(v, -1 - cell, 15, 15);
            }
        }
        full |= found > capacity;
    }
    count = wp::min(found, capacity);
    status = (status & ~OVERFLOW) | (some_of_group(full) ? OVERFLOW : 0);
    sync();
};
