// The beginning of functions (model, ..., mesh, ..., lane) about springs: the tables of a mesh that they read.

const int springs = wp::index(model.springs, mesh);
const int actives = 2 * wp::index(model.actives, mesh);
const int* active = &wp::index(model.active, mesh, 0);
const int* free_lanes = &wp::index(model.free_lanes, mesh, 0);
const wp::vec_t<2, int>* spring_ends = &wp::index(model.spring_ends, mesh, 0);
const auto spring_k = lane_table(model.spring_k, mesh);
