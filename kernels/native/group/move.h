// Springs and motion of a sub-step: relaxation of lengths, the classical Runge-Kutta method over displacements, as
// in integrate.h. Formulas and the order of sums are those of integrate.h.

Pair vec[SPRING_ROUNDS];                          // spring vector at the sub-step's start
Real rest[SPRING_ROUNDS], offset[SPRING_ROUNDS];  // 1 / length^2, force density; approximate: 1 / length^2, l_eq / length - 1
double move[POINT_ROUNDS][2];

double* goal = nullptr;

auto load_springs = [&]() {
    const wp::vec_t<2, int>* spring_ends = row_of(model.spring_ends, mesh);
    const double* spring_rest = row_of(model.spring_rest, mesh);
    const Real* stiffness = state_of(model.spring_k, mesh);
    const int* spring_drive = state_of(model.spring_drive, mesh);
    const double* action = state_of(data.action, pack);
    double* goal = state_of(data.goal, pack);
    ROLL for (int s = part; s < SPRINGS; s += PARTS) {
        const int t = s < springs ? s : 0;  // what is no spring is one without stiffness
        const Real rest0 = Real(spring_rest[t]);
        at.spring[s].ends = place_of(at.disp, spring_ends[t][0]) | place_of(at.disp, spring_ends[t][1]) << 16;
        at.spring[s].stiffness = s < springs ? stiffness[s] : Real(0);
        at.length[s].middle = rest0 * rest0 * (Real(1) + model.strain_limit * model.strain_limit);
        at.length[s].goal = Real(1);
        if (s >= springs) continue;
        const int drive = spring_drive[s], first = (drive & 0xffff) - 1, second = (drive >> 16 & 0xffff) - 1;
        double length = spring_rest[s];
        if (second >= 0) {
            length = (action[first] + action[second]) * (length * 0.5);
        } else if (first >= 0) {
            length = action[first] * length;
        }
        goal[s] = APPROXIMATE ? length * length : length;
        at.length[s].goal = Real(length);
    }
};

auto pull = [&](int j, Real size, Real x, Real y) {
    at.tension[2 + part + PARTS * j] = Pair{size * x, size * y};
};
// On CUDA the tables have rows for all rounds of springs but some of the last, so that these need no test.
auto has_row = [](int j) -> bool { return TIGHT && j + 1 < SPRING_ROUNDS; };
// Spring vectors, lengths and l_eq - l = rate (goal - l), in float64: the rounding of lengths would act like another goal.
auto relax = [&](int j) {
    if (SPRING_ROUNDS <= FEW && j % 4 == 0 && j) fence();
    const int s = part + PARTS * j;
    const unsigned ends = at.spring[s].ends;
    const Real stiffness = at.spring[s].stiffness;
    unsigned first = ends & 0xffff, second = ends >> 16;
    KEEP(first);
    KEEP(second);
    const Place a = pos_at(first), b = pos_at(second);
    const double x = b.x - a.x, y = b.y - a.y, aim = has_row(j) || s < springs ? goal[s] : 0.0;
    vec[j] = Pair{Real(x), Real(y)};
#if APPROXIMATE
    const Real near_square = fused(vec[j].x, vec[j].x, vec[j].y * vec[j].y), over = inverse_root(near_square);
    // goal - l = (goal^2 - l^2) / (goal + l), of which only the difference of the squares needs float64.
    const Real excess = Real(fused_wide(-x, x, fused_wide(-y, y, aim)));
    const Real both = fused(near_square, over, at.length[s].goal);
    rest[j] = over * over;
    offset[j] = excess * inverse(both) * (over * Real(model.actuation_rate));
    const Real force = -offset[j] * stiffness;
#else
    relaxed(vec[j].x, vec[j].y, Real(aim * aim - (x * x + y * y)), Real(aim), stiffness, rest[j], offset[j]);
    const Real force = offset[j];
#endif
    pull(j, force, vec[j].x, vec[j].y);
};
auto own_points = [&](auto&& act) {
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        if (within(j, MOVERS) && (POINT_ROUNDS <= FEW || PARTS * j < points)) act(j, part + PARTS * j);
    }
};
auto own_springs = [&](auto&& act) {
    EACH_SPRING for (int j = 0; j < SPRING_ROUNDS; ++j) {
        if (!within(j, SPRINGS) || SPRING_ROUNDS > FEW && PARTS * j >= springs) break;
        act(j);
    }
};
// Hooke force k (l - l_eq) of a spring on its first end.
auto stretch = [&](int j) {
    const int s = part + PARTS * j;
    const unsigned ends = at.spring[s].ends;
    const Real stiffness = at.spring[s].stiffness;
    const Pair a = pair_at(at.disp, ends & 0xffff), b = pair_at(at.disp, ends >> 16);
    const Real ux = b.x - a.x, uy = b.y - a.y;
#if APPROXIMATE
    // With e = d + u and w = |e|^2 / |d|^2 - 1: k (l - l_eq) / l = k (w / (1 + w + sqrt(1 + w)) - offset / sqrt(1 + w)).
    const Real ex = vec[j].x + ux, ey = vec[j].y + uy;
    const Real twice = fused(vec[j].x + ex, ux, (vec[j].y + ey) * uy), square = fused(twice, rest[j], Real(1));
    const Real over = inverse_root(square), share = twice * rest[j] * inverse(fused(square, over, square));
    const Real size = reduced(offset[j], over, share) * stiffness;
    pull(j, size, ex, ey);
#else
    Pair force;
    spring_force(vec[j].x, vec[j].y, ux, uy, rest[j], offset[j], stiffness, force.x, force.y);
    pull(j, Real(1), force.x, force.y);
#endif
};

auto runge_kutta = [&]() {
    Pair start_vel[POINT_ROUNDS], stage_vel[POINT_ROUNDS], sum_gain[POINT_ROUNDS], sum_force[POINT_ROUNDS];
    Real height[POINT_ROUNDS], lowest_point = Real(1);
    int row = pack;
    HIDE(row);
    goal = state_of(data.goal, row);
    if (part < 2) {  // of places without a spring; contacts were here
        const Real none = part ? Real(-0.0) : Real(0);
        at.tension[part] = Pair{none, none};
    }
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        start_vel[j] = stage_vel[j] = Pair{Real(vel[j][0]), Real(vel[j][1])};
        height[j] = within(j, MOVERS) ? Real(at.pos[part + PARTS * j].y) : Real(1);
        lowest_point = lower(height[j], lowest_point);
        sum_gain[j] = sum_force[j] = Pair{Real(0), Real(0)};
    }
    EACH_SPRING for (int j = 0; j < SPRING_ROUNDS; ++j) {  // without a value registers would be kept for all the sub-step
        vec[j] = Pair{Real(0), Real(0)};
        rest[j] = offset[j] = Real(0);
    }
    ROLL for (int stage = 0; stage < 4; ++stage) {
        HIDE(stage);
        // The last stage goes into the sum of velocities alone; what it leaves as displacement is replaced below.
        const Real early = stage < 3 ? Real(1) : Real(0), weight = stage % 3 ? Real(2) : Real(1);
        const Real ahead = stage < 2 ? Real(dt) * Real(0.5) : Real(dt), later = ahead * model.inverse_mass;
        if (stage) {
            own_springs(stretch);
        } else {
            own_springs(relax);
        }
        sync();
        Pair force[POINT_ROUNDS];
        own_points([&](int j, int p) {
            const Pair v = stage_vel[j];
            force[j].x = fused(-v.x, model.drag, at.contact[p].x);
            force[j].y = fused(-v.y, model.drag, at.contact[p].y) - (APPROXIMATE ? Real(0) : model.weight);
        });
        if (lowest_point <= Real(0)) {  // the implicit floor at y = 0
            own_points([&](int j, int p) {
                const Real above = stage ? height[j] + at.disp[p].y : height[j];
                if (above <= Real(0)) floor_contact(force[j].x, force[j].y, stage_vel[j].x, above);
            });
        }
        lowest_point = Real(1);
        own_points([&](int j, int p) {
            if (POINT_ROUNDS <= FEW && j % 2 == 0 && j) fence();
            const Pair v = stage_vel[j];
            Real fx = force[j].x, fy = force[j].y;
            const Links links = at.links[p];
            const Real sign = links.place[FOURTH] & ADDED ? Real(1) : Real(-1);
            UNROLL for (int n = 0; n < LINKS; ++n) {
                const Pair pulls = pair_at(at.tension, n == FOURTH ? links.place[n] & ~ADDED : links.place[n]);
                if (n == FOURTH) {
                    fx = fused(sign, pulls.x, fx);
                    fy = fused(sign, pulls.y, fy);
                } else {
                    fx = n < FOURTH ? fx - pulls.x : fx + pulls.x;
                    fy = n < FOURTH ? fy - pulls.y : fy + pulls.y;
                }
            }
            sum_force[j] = Pair{fused(fx, early, sum_force[j].x), fused(fy, early, sum_force[j].y)};
            sum_gain[j] = Pair{fused(fx, weight, sum_gain[j].x), fused(fy, weight, sum_gain[j].y)};
            const Pair moved{v.x * ahead, v.y * ahead};
            at.disp[p] = moved;
            lowest_point = lower(height[j] + moved.y, lowest_point);
            stage_vel[j] = Pair{fused(fx, later, start_vel[j].x), fused(fy, later, start_vel[j].y)};
        });
        sync();
    }
    // x += dt v + dt^2 / 6 (a1 + a2 + a3) and v += dt / 6 (a1 + 2 a2 + 2 a3 + a4), in float64. A fixed point takes part in
    // the stages; only its update is dropped.
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        const bool free = loose >> j & 1;
        const double sixth = dt / 6.0 * double(model.inverse_mass);
        move[j][0] = free ? vel[j][0] * dt + double(sum_force[j].x) * (sixth * dt) : 0.0;
        move[j][1] = free ? vel[j][1] * dt + double(sum_force[j].y) * (sixth * dt) : 0.0;
        vel[j][0] = vel[j][0] + double(free ? sum_gain[j].x : Real(0)) * sixth;
        vel[j][1] = vel[j][1] + double(free ? sum_gain[j].y : Real(0)) * sixth;
        if (within(j, MOVERS)) at.disp[part + PARTS * j] = Pair{Real(move[j][0]), Real(move[j][1])};
    }
    sync();
};
