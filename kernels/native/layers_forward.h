// Body of a function (table, design), after products.h and layers_table.h: outputs of all layers of a network, tanh after each but the last.

// 1 - 2 / (1 + exp(2 x)); exp by its series about the nearest power of 2, to float32's precision
auto hyperbolic_tangent = [](Lanes x) {
    x = x + x;
    x = x > 40.0f ? Lanes{} + 40.0f : x;
    x = x < -40.0f ? Lanes{} - 40.0f : x;
    const float magic = 12582912.0f;  // 1.5 * 2^23: adding it rounds to a whole number
    const Lanes whole = (x * 1.44269504f + magic) - magic;
    const Lanes rest = (x - whole * 0.693359375f) + whole * 2.12194440e-4f;
    Lanes power = Lanes{} + 1.0f / 5040.0f;
    const float series[] = {1.0f / 720, 1.0f / 120, 1.0f / 24, 1.0f / 6, 0.5f, 1.0f, 1.0f};
    #pragma unroll
    for (int k = 0; k < 7; ++k) power = __builtin_elementwise_fma(power, rest, Lanes{} + series[k]);
    const Bits exponent = (__builtin_convertvector(whole, Bits) + 127) << 23;
    return 1.0f - 2.0f / (1.0f + power * (Lanes)exponent);
};

float* panel = t.scratch;  // weights as [input][width], layer after layer
for (int k = 0; k < t.layers; ++k) {
    const Layer& own = layer[k];
    const long inputs = k ? layer[k - 1].size : t.inputs;
    const float* weight = own.weight + design * own.of_design;
    const float* bias = own.bias + design * own.bias_of_design;
    for (long i = 0; i < inputs; ++i) {
        const float* row = weight + i * own.of_input;
        float* copy = panel + i * own.width;
        if (own.of_output == 1) {
            for (long j = 0; j < own.size; ++j) copy[j] = row[j];
        } else {
            for (long j = 0; j < own.size; ++j) copy[j] = row[j * own.of_output];
        }
        for (long j = own.size; j < own.width; ++j) copy[j] = 0.0f;
    }
    panel += inputs * own.width;
    for (long j = 0; j < own.width; ++j) panel[j] = j < own.size ? bias[j] : 0.0f;
    panel += own.width;
}
for (long begin = 0; begin < t.rows; begin += t.tile) {
    const long count = t.rows - begin < t.tile ? t.rows - begin : t.tile;
    const float* before = given + begin * t.of_row;
    long pitch = t.of_row, inputs = t.inputs;
    panel = t.scratch;
    for (int k = 0; k < t.layers; ++k) {
        const long width = layer[k].width;
        float* out = layer[k].values + (design * t.rows + begin) * width;
        product(count, width, before, pitch, 1, panel, width, inputs, out, width, panel + inputs * width, false);
        if (k + 1 < t.layers) {
            for (long n = 0; n < count * width; n += LANES) *(Lanes*)(out + n) = hyperbolic_tangent(*(Lanes*)(out + n));
        }
        panel += (inputs + 1) * width;
        before = out;
        pitch = width;
        inputs = layer[k].size;
    }
}
