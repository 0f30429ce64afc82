// Body of a stage: the goals of all springs from the actions.

const auto action = wides(data.action);
const auto goal = wides(data.goal);
const int springs = wp::index(model.springs, mesh);
for (int s = 0; s < springs; ++s) {
    const double rest = wp::index(model.spring_rest, mesh, s);
    const int* drive = &wp::index(model.spring_drive, mesh, s, lane);
    bool alike = true;  // as in lanes of one body
    each_lane([&](int k) { alike &= drive[k] == drive[0]; });
    if (alike) {
        const int first = (drive[0] & 0xffff) - 1, second = (drive[0] >> 16 & 0xffff) - 1;
        if (second >= 0) {
            goal[s] = (action[first] + action[second]) * (rest * 0.5);
        } else if (first >= 0) {
            goal[s] = action[first] * rest;
        } else {
            goal[s] = (Wide)rest;
        }
        continue;
    }
    each_lane([&](int k) {
        const int first = (drive[k] & 0xffff) - 1, second = (drive[k] >> 16 & 0xffff) - 1;
        double length = rest;
        if (second >= 0) {
            length = (lane_of(action[first], k) + lane_of(action[second], k)) * (rest * 0.5);
        } else if (first >= 0) {
            length = lane_of(action[first], k) * rest;
        }
        set_lane(goal[s], k, length);
    });
}
