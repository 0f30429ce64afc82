// After springs.h: twins in derivatives. The sum over a leader and its twins is the derivative by each of them.

const int points = wp::index(model.points, mesh);
const int twins = wp::index(model.twins, mesh);
const wp::vec_t<2, int>* twin = &wp::index(model.twin, mesh, 0);
const wp::vec_t<2, int>* twin_range = &wp::index(model.twin_range, mesh, 0);
const int* twin_lanes = &wp::index(model.twin_lanes, mesh, 0);
// Of each point, `each` rows from row `first` on.
auto fold_twins = [&](const auto& rows, int first, int each) {
    for (int pass = 0; pass < 2; ++pass) {
        for (int e = 0; e < twins; ++e) {
            const Value follows = weights(twin_lanes[e]);
            for (int k = 0; k < each; ++k) {
                auto &own = rows[first + each * twin[e][0] + k], &leader = rows[first + each * twin[e][1] + k];
                if (pass == 0) leader = leader + own * follows;
                if (pass == 1) own = own * (Real(1) - follows) + leader * follows;
            }
        }
    }
};
