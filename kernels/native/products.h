// Matrix products for small matrices that stay in the cache, with 16 lanes of AVX-512.

typedef float Lanes __attribute__((vector_size(64), aligned(4)));
typedef int Bits __attribute__((vector_size(64), aligned(4)));
enum { LANES = 16 };

struct One { enum { n = 1 }; };
struct Two { enum { n = 2 }; };
struct Four { enum { n = 4 }; };
struct Six { enum { n = 6 }; };

// c[r][..] (+)= start[..] + sum over k of a[r * row + k * step] b[k][..] for a few rows of `vectors` times 16 columns, in
// registers. Sums go over k in order, whatever else there is.
auto block = [](auto rows, auto vectors, const float* a, long row, long step, const float* b, long b_row, int count,
                float* c, long c_row, const float* start, bool add) {
    enum { R = decltype(rows)::n, W = decltype(vectors)::n };
    Lanes sum[R][W];
    #pragma unroll
    for (int r = 0; r < R; ++r) {
        #pragma unroll
        for (int v = 0; v < W; ++v) {
            sum[r][v] = add ? *(const Lanes*)(c + r * c_row + LANES * v)
                      : start ? *(const Lanes*)(start + LANES * v) : Lanes{};
        }
    }
    for (int k = 0; k < count; ++k) {
        Lanes right[W];
        #pragma unroll
        for (int v = 0; v < W; ++v) right[v] = *(const Lanes*)(b + k * b_row + LANES * v);
        #pragma unroll
        for (int r = 0; r < R; ++r) {
            const Lanes left = Lanes{} + a[r * row + k * step];
            #pragma unroll
            for (int v = 0; v < W; ++v) sum[r][v] = __builtin_elementwise_fma(left, right[v], sum[r][v]);
        }
    }
    #pragma unroll
    for (int r = 0; r < R; ++r) {
        #pragma unroll
        for (int v = 0; v < W; ++v) *(Lanes*)(c + r * c_row + LANES * v) = sum[r][v];
    }
};

// The same for any number of rows and a multiple of 16 columns.
auto product = [&](int rows, int columns, const float* a, long row, long step, const float* b, long b_row, int count,
                   float* c, long c_row, const float* start, bool add) {
    auto strip = [&](auto vectors, int j) {
        const float* first = start ? start + j : start;
        int i = 0;
        for (; i + 6 <= rows; i += 6) {
            block(Six(), vectors, a + i * row, row, step, b + j, b_row, count, c + i * c_row + j, c_row, first, add);
        }
        for (; i + 4 <= rows; i += 4) {
            block(Four(), vectors, a + i * row, row, step, b + j, b_row, count, c + i * c_row + j, c_row, first, add);
        }
        for (; i < rows; ++i) {
            block(One(), vectors, a + i * row, row, step, b + j, b_row, count, c + i * c_row + j, c_row, first, add);
        }
    };
    int j = 0;
    for (; j + 64 <= columns; j += 64) strip(Four(), j);
    for (; j + 32 <= columns; j += 32) strip(Two(), j);
    for (; j + 16 <= columns; j += 16) strip(One(), j);
};
