// Body of a function (model, data, tape, mesh, pack, lane, unit): the state at the start of a sub-step onto the tape.

const int points = wp::index(model.points, mesh), n = wp::index(tape.substeps, unit);
const auto pos = wides(data.pos), vel = wides(data.vel);
const auto kept_pos = values(tape.pos), kept_vel = values(tape.vel), contact = values(tape.contact);
for (int r = 0; r < 2 * points; ++r) {
    kept_pos[2 * points * n + r] = narrow(pos[r]);
    kept_vel[2 * points * n + r] = narrow(vel[r]);
}
for (int r = 0; r < 6 * points; ++r) contact[6 * points * n + r] = Value{};
wp::index(tape.substeps, unit) = n + 1;
