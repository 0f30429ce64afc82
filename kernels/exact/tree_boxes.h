// Body of a stage: boxes of the nodes over surface voxels, children before parents.

const auto box = values(data.box), node_box = values(data.node_box);
for (int n = 0; n < wp::index(model.nodes, mesh); ++n) {
    const wp::vec_t<4, int> node = wp::index(model.node, mesh, n);
    for (int side = 0; side < 4; ++side) {
        if (node[0] < 0) {
            node_box[4 * n + side] = box[4 * (-1 - node[0]) + side];
            continue;
        }
        const Value a = node_box[4 * node[0] + side], b = node_box[4 * node[1] + side];
        node_box[4 * n + side] = side % 2 ? (b > a ? b : a) : (b < a ? b : a);
    }
}
