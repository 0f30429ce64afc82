// The description of layers that kernels/layers.py writes as whole numbers; for the body of a function (table, design).

struct Layer {
    long size, width;  // outputs, and those as a multiple of 16
    const float* weight;
    long of_design, of_input, of_output;  // its strides
    const float* bias;
    long bias_of_design;
    float* values;  // [design][row][width]
    float* weight_gradient;  // [design][input][width]
    float* bias_gradient;  // [design][width]
};
struct Table {
    long layers, rows, inputs, tile;
    const float* given;
    long of_design, of_row;  // its strides
    float* scratch;
};
const Table& t = *(const Table*)table;
const Layer* layer = (const Layer*)(&t + 1);
const float* given = t.given + design * t.of_design;
