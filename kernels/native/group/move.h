// Springs and motion of a sub-step: relaxation of lengths, the classical Runge-Kutta method over displacements, as
// in integrate.h. Formulas and the order of sums are those of integrate.h.

Pair vec[SPRING_ROUNDS];                          // spring vector at the sub-step's start
Real rest[SPRING_ROUNDS], offset[SPRING_ROUNDS];  // its length, l_eq - length
double move[POINT_ROUNDS][2];
const Real tiny = Real(1e-30);

double* goal = nullptr;

auto load_springs = [&]() {
    const wp::vec_t<2, int>* spring_ends = row_of(model.spring_ends, mesh);
    const double* spring_rest = row_of(model.spring_rest, mesh);
    double* goal = state_of(data.goal, pack);
    EACH_SPRING for (int j = 0; j < SPRING_ROUNDS; ++j) {
        const int s = part + PARTS * j, t = s < springs ? s : 0;
        const Real rest0 = Real(spring_rest[t]);
        const Real longest = rest0 * (Real(1) + model.strain_limit), shortest = rest0 * (Real(1) - model.strain_limit);
        at.spring[s].ends = spring_ends[t][0] | spring_ends[t][1] << 16;
        at.spring[s].stiffness = s < springs ? wp::index(model.spring_k, mesh, t, 0) : Real(0);
        at.spring[s].longest = s < springs ? longest * longest : Real(INFINITY);
        at.spring[s].shortest = s < springs ? shortest * shortest : Real(-1);
        if (s >= springs) continue;
        const int drive = wp::index(model.spring_drive, mesh, s, 0), first = (drive & 0xffff) - 1, second = (drive >> 16) - 1;
        double length = spring_rest[s];
        if (second >= 0) {
            length = (wp::index(data.action, pack, first, 0) + wp::index(data.action, pack, second, 0)) * (length * 0.5);
        } else if (first >= 0) {
            length = wp::index(data.action, pack, first, 0) * length;
        }
        goal[s] = length;
    }
};

// Spring vectors, lengths and l_eq - l = rate (goal - l), in float64: the rounding of lengths would act like another goal.
auto relax = [&](int j) {
    COUNT(relax);
    const int s = part + PARTS * j;
    const unsigned ends = at.spring[s].ends;
    const Real stiffness = at.spring[s].stiffness;
    const Place a = at.pos[ends & 0xffff], b = at.pos[ends >> 16];
    const double x = b.x - a.x, y = b.y - a.y, aim = s < springs ? goal[s] : 0.0;
    vec[j] = Pair{Real(x), Real(y)};
#if APPROXIMATE
    const Real near_square = vec[j].x * vec[j].x + vec[j].y * vec[j].y, over = inverse_root(near_square);
    rest[j] = near_square * over;
    // The square of the length minus that of `rest`, from which the length follows to double precision.
    const double wide = double(rest[j]);
    const Real left = Real(fused_wide(-wide, wide, fused_wide(x, x, y * y))) * Real(0.5) * over;
    offset[j] = Real((aim - wide) * model.actuation_rate) - left * Real(model.actuation_rate);
    const Real force = -offset[j] * stiffness * over;
#else
    const double length = wp::sqrt(x * x + y * y);
    rest[j] = Real(length);
    offset[j] = Real((aim - length) * model.actuation_rate);
    const Real force = -offset[j] * stiffness / (rest[j] + tiny);
#endif
    return Pair{force * vec[j].x, force * vec[j].y};
};
// Hooke force k (l - l_eq) of a spring on its first end.
auto stretch = [&](int j) {
    COUNT(stretch);
    const unsigned ends = at.spring[part + PARTS * j].ends;
    const Real stiffness = at.spring[part + PARTS * j].stiffness;
    const Pair a = at.disp[ends & 0xffff], b = at.disp[ends >> 16];
    Pair force;
    spring_force(vec[j].x, vec[j].y, b.x - a.x, b.y - a.y, rest[j], offset[j], stiffness, force.x, force.y);
    return force;
};

auto runge_kutta = [&]() {
    Pair start_vel[POINT_ROUNDS], stage_vel[POINT_ROUNDS], sum_vel[POINT_ROUNDS], sum_acc[POINT_ROUNDS];
    Real height[POINT_ROUNDS];
    int row = pack;
    HIDE(row);
    goal = state_of(data.goal, row);
    if (part == 0) at.tension[2 * SPRINGS] = Pair{Real(-0.0), Real(-0.0)};  // of a place without a spring; contacts were here
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        start_vel[j] = stage_vel[j] = Pair{Real(vel[j][0]), Real(vel[j][1])};
        height[j] = Real(at.pos[part + PARTS * j].y);
        at.disp[part + PARTS * j] = Pair{Real(0), Real(0)};
        sum_vel[j] = sum_acc[j] = Pair{Real(0), Real(0)};
    }
    ROLL for (int stage = 0; stage < 4; ++stage) {
        COUNT(stage);
        HIDE(stage);
        const Real ahead = stage < 2 ? Real(dt) * Real(0.5) : Real(dt);
        EACH_SPRING for (int j = 0; j < SPRING_ROUNDS; ++j) {
            if (SPRING_ROUNDS > FEW && PARTS * j >= springs) break;
            const int s = part + PARTS * j;
            const Pair force = stage ? stretch(j) : relax(j);
            at.tension[2 * s] = force;
            at.tension[2 * s + 1] = Pair{-force.x, -force.y};
        }
        sync();
        EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
            if (POINT_ROUNDS > FEW && PARTS * j >= points) break;
            COUNT(point);
            const int p = part + PARTS * j;
            const Pair v = stage_vel[j];
            Real fx = fused(-v.x, model.drag, at.contact[p].x), fy = fused(-v.y, model.drag, at.contact[p].y) - model.weight;
            const Real above = height[j] + at.disp[p].y;
            if (above <= Real(0)) {  // the implicit floor at y = 0
                COUNT(floor);
                Real normal, drag;
                floor_force(above, v.x, normal, drag);
                fx = fx - drag;
                fy = fy + normal;
            }
            const Links links = at.links[p];
            UNROLL for (int n = 0; n < LINKS; ++n) {
                const Pair force = at.tension[links.place[n]];
                fx = fx + force.x;
                fy = fy + force.y;
            }
            if (more_links && p < points) {
                COUNT(more_links);
                int own = mesh;
                HIDE(own);
                const int* link_start = row_of(model.link_start, own);
                const int* link = row_of(model.link, own);
                ROLL for (int n = link_start[p] + LINKS; n < link_start[p + 1]; ++n) {
                    const Pair force = at.tension[link[n] >= 0 ? 2 * link[n] : 2 * (-1 - link[n]) + 1];
                    fx = fx + force.x;
                    fy = fy + force.y;
                }
            }
            const Real ax = fx * model.inverse_mass, ay = fy * model.inverse_mass;
            if (stage == 3) {
                sum_vel[j] = Pair{sum_vel[j].x + ax, sum_vel[j].y + ay};
                continue;
            }
            const Real weight = stage ? Real(2) : Real(1);
            sum_acc[j] = Pair{sum_acc[j].x + ax, sum_acc[j].y + ay};
            sum_vel[j] = Pair{fused(ax, weight, sum_vel[j].x), fused(ay, weight, sum_vel[j].y)};
            at.disp[p] = Pair{v.x * ahead, v.y * ahead};
            stage_vel[j] = Pair{fused(ax, ahead, start_vel[j].x), fused(ay, ahead, start_vel[j].y)};
        }
        sync();
    }
    COUNT(finish);
    // x += dt v + dt^2 / 6 (a1 + a2 + a3) and v += dt / 6 (a1 + 2 a2 + 2 a3 + a4), in float64. A fixed point takes part in
    // the stages; only its update is dropped.
    EACH_POINT for (int j = 0; j < POINT_ROUNDS; ++j) {
        const double free = loose >> j & 1 ? 1.0 : 0.0, sixth = free * dt / 6.0;
        move[j][0] = vel[j][0] * (free * dt) + double(sum_acc[j].x) * (sixth * dt);
        move[j][1] = vel[j][1] * (free * dt) + double(sum_acc[j].y) * (sixth * dt);
        vel[j][0] = vel[j][0] + double(sum_vel[j].x) * sixth;
        vel[j][1] = vel[j][1] + double(sum_vel[j].y) * sixth;
        at.disp[part + PARTS * j] = Pair{Real(move[j][0]), Real(move[j][1])};
    }
    sync();
};
