// Body of a function (model, tape, mesh, pack, lane, unit): derivatives by the actions from those by the goals of springs.

const auto by_goal = values(tape.by_goal), by_action = values(tape.by_action);
const int actions = tape.by_action.shape[1];
for (int a = 0; a < actions; ++a) by_action[a] = Value{};
const int springs = wp::index(model.springs, mesh);
for (int s = 0; s < springs; ++s) {
    const Real rest = Real(wp::index(model.spring_rest, mesh, s));
    const int* drive = &wp::index(model.spring_drive, mesh, s, lane);
    each_lane([&](int k) {
        const int first = (drive[k] & 0xffff) - 1, second = (drive[k] >> 16 & 0xffff) - 1;
        if (first < 0) return;
        const Real share = lane_of(by_goal[s], k) * rest * (second < 0 ? Real(1) : Real(0.5));
        set_lane(by_action[first], k, lane_of(by_action[first], k) + share);
        if (second >= 0) set_lane(by_action[second], k, lane_of(by_action[second], k) + share);
    });
}
