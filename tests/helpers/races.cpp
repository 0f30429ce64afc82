// Runs the blocks of a kernel thread by thread, from one meeting to the next, and remembers who has read and written what:
// the callbacks that gcc's -fsanitize=thread inserts, and the functions that Warp's cooperative blocks call.

#include <ucontext.h>

#include <cstdint>
#include <cstdlib>
#include <map>
#include <tuple>
#include <vector>

namespace {
enum Kind { WRITE_WRITE, WRITE_READ, READ_WRITE, APART };
struct Range { uintptr_t begin, size, period, kept; size_t first; };
struct Trace {
    unsigned written = 0, read = 0;  // since which barrier, which meeting
    int writer = -1, reader = -1;
    bool atomic = false;   // the last write
    bool several = false;  // others have read, too
    void *write_at = nullptr, *read_at = nullptr;
};
constexpr int MOST = 512, GRAIN = 2;  // threads; bytes that are told apart
std::vector<Range> ranges;
std::vector<Trace> traces;
std::map<std::tuple<int, uintptr_t, uintptr_t>, long> found;
unsigned barrier = 1, meeting = 1;
int current = -1;
bool backwards = false;
long accesses = 0;

ucontext_t scheduler, context[MOST];
char* stack[MOST];
int kind[MOST];  // of the meeting at which a thread waits; -1: it has ended
typedef void (*Lane)(void*, size_t, int, void*);
struct { Lane lane; void *dim, *args; size_t id; } block;

void note(Kind what, void* first, void* second) { ++found[{what, uintptr_t(first), uintptr_t(second)}]; }

void touch(void* address, size_t size, bool write, void* at, bool atomic = false) {
    if (current < 0) return;
    for (const Range& range : ranges) {
        const uintptr_t offset = uintptr_t(address) - range.begin;  // wraps below
        if (offset >= range.size) continue;
        if (offset % range.period >= range.kept) return;
        ++accesses;
        for (size_t k = offset / GRAIN; k <= (offset + size - 1) / GRAIN; ++k) {
            Trace& trace = traces[range.first + k];
            if (trace.written == barrier && trace.writer != current && !(atomic && trace.atomic)) {
                note(write ? WRITE_WRITE : WRITE_READ, trace.write_at, at);
            }
            if (write) {
                // A vote is no barrier, but what is written after it depends on what was read before.
                if (trace.read == meeting && (trace.several || trace.reader != current)) note(READ_WRITE, trace.read_at, at);
                trace.written = barrier;
                trace.writer = current;
                trace.atomic = atomic;
                trace.write_at = at;
            } else {
                trace.several = trace.read == meeting && (trace.several || trace.reader != current);
                trace.reader = current;
                trace.read = meeting;
                trace.read_at = at;
            }
        }
        return;
    }
}
void begin(int lane) {
    block.lane(block.dim, block.id, lane, block.args);
    kind[lane] = -1;
    swapcontext(&context[lane], &scheduler);
}
}  // namespace

extern "C" {
// The test's side. Of every `period` bytes the first `kept` are watched.
void watch(uintptr_t begin, size_t size, size_t period, size_t kept) {
    ranges.push_back({begin, size, period, kept, traces.size()});
    traces.resize(traces.size() + size / GRAIN + 1);
}
void run_backwards(int yes) { backwards = yes; }
long watched() { return accesses; }
size_t conflicts(uintptr_t* rows, size_t most) {  // kind, both instructions, count
    size_t n = 0;
    for (const auto& [key, count] : found) {
        if (n == most) break;
        const uintptr_t row[4] = {uintptr_t(std::get<0>(key)), std::get<1>(key), std::get<2>(key), uintptr_t(count)};
        for (int k = 0; k < 4; ++k) rows[4 * n + k] = row[k];
        ++n;
    }
    return n;
}

// The kernel's side: 1 at a barrier, 0 at a vote.
void meet(int what) {
    kind[current] = what;
    swapcontext(&context[current], &scheduler);
}
int wp_cpu_get_thread_idx() { return current; }
int wp_cpu_get_first_active_lane() { return 0; }
void wp_cpu_tile_sync() { meet(1); }
void _wp_assert(const char*, const char*, unsigned) { abort(); }
int wp_cpu_run_block(int, int count, Lane lane, void* dim, size_t id, void* args) {
    block = {lane, dim, args, id};
    for (int k = 0; k < count; ++k) {
        constexpr size_t SIZE = 1 << 20;
        if (!stack[k]) stack[k] = static_cast<char*>(malloc(SIZE));
        getcontext(&context[k]);
        context[k].uc_stack.ss_sp = stack[k];
        context[k].uc_stack.ss_size = SIZE;
        context[k].uc_link = nullptr;
        makecontext(&context[k], reinterpret_cast<void (*)()>(begin), 1, k);
    }
    do {
        ++meeting;
        if (kind[0] != 0) ++barrier;
        for (int k = 0; k < count; ++k) {
            current = backwards ? count - 1 - k : k;
            swapcontext(&scheduler, &context[current]);
        }
        current = -1;
        for (int k = 1; k < count; ++k) {
            if (kind[k] == kind[0]) continue;
            note(APART, nullptr, nullptr);
            return 1;
        }
    } while (kind[0] >= 0);
    return 1;
}

#define PLACE __builtin_return_address(0)
#define WATCH(n)                                                                             \
    void __tsan_read##n(void* p) { touch(p, n, false, PLACE); }                               \
    void __tsan_write##n(void* p) { touch(p, n, true, PLACE); }                               \
    void __tsan_unaligned_read##n(void* p) { touch(p, n, false, PLACE); }                     \
    void __tsan_unaligned_write##n(void* p) { touch(p, n, true, PLACE); }
WATCH(1) WATCH(2) WATCH(4) WATCH(8) WATCH(16)
void __tsan_read_range(void* p, size_t n) { touch(p, n, false, PLACE); }
void __tsan_write_range(void* p, size_t n) { touch(p, n, true, PLACE); }
int __tsan_atomic32_fetch_or(int* p, int bits, int) {
    touch(p, sizeof *p, true, PLACE, true);
    const int before = *p;
    *p |= bits;
    return before;
}
void __tsan_init() {}
void __tsan_func_entry(void*) {}
void __tsan_func_exit() {}
}
