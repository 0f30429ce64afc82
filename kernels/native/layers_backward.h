// Body of a function (table, design), after products.h and layers_table.h: gradients of weights and biases of all layers.
// The last layer's values are the gradient of the outputs.

float* panel = t.scratch;  // weights as [output][width of the layer before], layer after layer from the second on
for (int k = 1; k < t.layers; ++k) {
    const Layer& own = layer[k];
    const Layer& last = layer[k - 1];
    const float* weight = own.weight + design * own.of_design;
    for (long j = 0; j < own.size; ++j) {
        for (long i = 0; i < last.width; ++i) {
            panel[j * last.width + i] = i < last.size ? weight[i * own.of_input + j * own.of_output] : 0.0f;
        }
    }
    panel += own.size * last.width;
}
float* passed[2] = {panel, panel};  // gradients on their way, [tile][width]
for (int k = 0; k < t.layers; ++k) {
    if (panel + t.tile * layer[k].width > passed[1]) passed[1] = panel + t.tile * layer[k].width;
}
for (long begin = 0; begin < t.rows; begin += t.tile) {
    const long count = t.rows - begin < t.tile ? t.rows - begin : t.tile;
    const float* gradient = layer[t.layers - 1].values + (design * t.rows + begin) * layer[t.layers - 1].width;
    const float* weights = panel;
    for (int k = t.layers - 1; k >= 0; --k) {
        const Layer& own = layer[k];
        const long inputs = k ? layer[k - 1].size : t.inputs, pitch = k ? layer[k - 1].width : t.of_row;
        const float* before = k ? layer[k - 1].values + (design * t.rows + begin) * pitch : given + begin * pitch;
        product(inputs, own.width, before, 1, pitch, gradient, own.width, count,
                own.weight_gradient + design * inputs * own.width, own.width, nullptr, begin > 0);
        float* sums = own.bias_gradient + design * own.width;
        for (long n = 0; n < own.width; n += LANES) {
            Lanes sum = begin ? *(Lanes*)(sums + n) : Lanes{};
            for (long r = 0; r < count; ++r) sum += *(const Lanes*)(gradient + r * own.width + n);
            *(Lanes*)(sums + n) = sum;
        }
        if (k == 0) break;
        weights -= own.size * pitch;
        float* next = passed[k % 2];
        product(count, pitch, gradient, own.width, 1, weights, pitch, own.size, next, pitch, nullptr, false);
        for (long n = 0; n < count * pitch; n += LANES) {
            const Lanes value = *(const Lanes*)(before + n);
            *(Lanes*)(next + n) *= 1.0f - value * value;
        }
        gradient = next;
    }
}
