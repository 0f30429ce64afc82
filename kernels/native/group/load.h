// The tables of the body and the state, into registers and shared memory. Packs have one lane.

const bool frozen = !live || wp::index(data.frozen, pack, 0) != 0;  // a group that only fills its warp is not live
int points = wp::index(model.points, mesh), springs = wp::index(model.springs, mesh);
int rigids = wp::index(model.rigids, mesh);
// A row of a table or of the state. Where one is looked up in every sub-step, its index is hidden from the compiler, which
// would keep all of these addresses in registers else.
auto row_of = [](const auto& table, int row) { return &wp::index(table, row, 0); };
auto state_of = [](const auto& table, int row) { return &wp::index(table, row, 0, 0); };

double vel[POINT_ROUNDS][2];
Bits loose = 0;  // of the own points those that are free
// Approximate, the weight of a point is taken for a contact.
const Pair no_contact{Real(0), APPROXIMATE ? -model.weight : Real(0)};
bool sound = true;

// The springs of a point, of which a sum has LINKS, ascend: first those whose second end it is, from the left, whose
// tension is subtracted; then those whose first end it is, up to the right, whose tension is added. Of the former there are
// up to four, of the latter up to five: place FOURTH may belong to either; ADDED says that it is added.
constexpr int FOURTH = 3;
const unsigned to_subtract = place_of(at.tension, 0), to_add = place_of(at.tension, 1);  // without a spring
// From numbers of tensions, two to an int; the highest bit of the fourth says that it is added.
auto links_of = [&](const wp::vec_t<4, int>& numbers) -> Links {
    Links links;
    UNROLL for (int k = 0; k < LINKS / 2; ++k) {
        unsigned two = (numbers[k] & 0x7fff7fff) * STEP + to_subtract * 0x10001;
        if (k == FOURTH / 2 && numbers[k] < 0) two |= ADDED << 16;
        links.place[2 * k] = two & 0xffff;
        links.place[2 * k + 1] = two >> 16;
    }
    return links;
};

auto load_points = [&]() {
    const wp::vec_t<4, int>* links = row_of(model.links, mesh);
    const int* free_lanes = row_of(model.free_lanes, mesh);
    const double* pos = &wp::index(data.pos, pack, 0, 0);
    const double* velocity = &wp::index(data.vel, pack, 0, 0);
    const double* true_vel = &wp::index(data.true_vel, pack, 0, 0);
    auto load_pos = [&](int p) {
        at.pos[p] = Place{pos[2 * p], pos[2 * p + 1]};
        for (int r = 2 * p; r < 2 * p + 2; ++r) {
            sound &= wp::abs(pos[r]) <= FARTHEST && wp::abs(velocity[r]) <= FASTEST && wp::abs(true_vel[r]) <= FASTEST;
        }
    };
    ROLL for (int p = MOVERS + part; MOVERS < POINTS && p < points; p += PARTS) load_pos(p);
    ROLL for (int p = part; p < MOVERS; p += PARTS) {
        at.links[p] = links_of(p < points ? links[p] : wp::vec_t<4, int>(0, 0, 0x10001, 0x10001));
    }
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        const int p = part + PARTS * j;
        vel[j][0] = vel[j][1] = 0.0;
        if (!within(j, MOVERS)) break;
        at.pos[p] = Place{0.0, 1.0};  // above the floor
        at.contact[p] = no_contact;
        at.touch.velocity[p] = Place{0.0, 0.0};
        if (p >= points) continue;
        load_pos(p);
        at.touch.velocity[p] = Place{true_vel[2 * p], true_vel[2 * p + 1]};
        vel[j][0] = velocity[2 * p];
        vel[j][1] = velocity[2 * p + 1];
        if (free_lanes[p]) loose |= Bits(1) << j;
    }
};

int pair_count = wp::index(data.pair_count, pack), count = pair_count + wp::index(data.near_count, pack);
int close_count = 0;
Single near_drift = STALE;  // the same since the corners near other voxels were listed
// In `status`, where a bit takes no register of its own: some distant voxels of a robot are near each other; frozen, or
// only here to fill the warp.
constexpr int FOLDING = 1 << 8, STILL = 1 << 9;
int status = wp::index(data.overflow, pack) ? OVERFLOW : 0;
bool any_folds = false;
Single drift = wp::index(data.drift, pack);  // bound of every point's path since the candidates were collected
