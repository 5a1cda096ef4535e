"""How the lanes of a GPU block work together: text that the snippets of `blending_cuda` begin with.

A block has WARPS warps of 32 lanes. On a GPU the words below are CUDA's own. With
`wp.config.enable_cpu_blocks`, where every thread of a block is a fiber of one CPU thread that runs until it
yields, they are spelled out with counters in static memory: slow, but the same snippets then run, lane by
lane and barrier by barrier, where there is no GPU.
"""

WARPS = 4
"""Warps of a block: each has a quarter of a tile, so a lane has two pixels."""

BLOCK = 32 * WARPS
"""Threads of a block."""

_THREAD = f"""
    constexpr int WARPS = {WARPS}, BLOCK = {BLOCK};
    const int thread = WP_TILE_THREAD_IDX, warp = thread / 32, lane = thread % 32;
"""

_WORDS = r"""
// ---- On a GPU.
#if defined(__CUDA_ARCH__)
    #define BLOCK_SHARED(Type, name) __shared__ Type name;
    auto block_barrier = []() { __syncthreads(); };
    auto block_any = [](bool vote) { return __syncthreads_or(vote) != 0; };   // a barrier that asks
    // bit k: the vote of lane k
    auto ballot = [](bool vote) { return __ballot_sync(0xffffffffu, vote); };
    // the value of lane ^ mask
    auto exchange = [](float value, int mask) { return __shfl_xor_sync(0xffffffffu, value, mask); };
    auto lowest_bit = [](unsigned bits) { return __ffs(bits) - 1; };
    // 16 bytes into shared memory, on their way until wait_for_copies and a barrier
    auto copy = [](void* shared, const void* source) {
    #if __CUDA_ARCH__ >= 800
        asm volatile("{ .reg .u64 place; cvta.to.shared.u64 place, %0; "
                     "cp.async.ca.shared.global [place], [%1], 16; }"
                     :: "l"(shared), "l"(source) : "memory");
    #else
        *(float4*)shared = *(const float4*)source;
    #endif
    };
    auto wait_for_copies = []() {
    #if __CUDA_ARCH__ >= 800
        asm volatile("cp.async.wait_all;" ::: "memory");
    #endif
    };
    auto least = [](float a, float b) { return fminf(a, b); };         // a NaN loses
    auto greatest = [](float a, float b) { return fmaxf(a, b); };
    // one instruction each, relative errors 2^-22 and 2^-23
    auto power_of_two = [](float t) {
        float result;
        asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(t));
        return result;
    };
    auto reciprocal = [](float v) {
        float result;
        asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(v));
        return result;
    };
// ---- On a CPU, fiber by fiber.
#else
    // an address that the compiler cannot follow: else it takes the memory for this fiber's alone
    #define BLOCK_SHARED(Type, name) static Type name##_memory; Type& name = *opaque(&name##_memory);
    auto opaque = [](auto* address) { asm volatile("" : "+r"(address)); return address; };
    // A fiber that has to wait lets the others run. Warps pass their barriers at their own pace, and arrivals
    // only ever count up, so that the next barrier needs no reset.
    struct Meeting { unsigned warp_arrivals[WARPS], block_arrivals; float value[BLOCK]; bool vote[BLOCK]; };
    BLOCK_SHARED(Meeting, meeting)
    auto wait = [](volatile unsigned& arrivals, unsigned members) {
        const unsigned full = (arrivals / members + 1) * members;
        arrivals = arrivals + 1;
        while (arrivals < full) WP_TILE_SYNC();
    };
    auto block_barrier = [&]() { wait(meeting.block_arrivals, BLOCK); };
    auto block_any = [&](bool vote) {
        bool any = false;
        meeting.vote[thread] = vote;
        block_barrier();
        for (int other = 0; other < BLOCK; ++other) any |= meeting.vote[other];
        block_barrier();
        return any;
    };
    auto warp_barrier = [&]() { wait(meeting.warp_arrivals[warp], 32); };
    auto ballot = [&](bool vote) {
        unsigned bits = 0;
        meeting.vote[thread] = vote;
        warp_barrier();
        for (int other = 0; other < 32; ++other) bits |= (unsigned)meeting.vote[warp * 32 + other] << other;
        warp_barrier();
        return bits;
    };
    auto exchange = [&](float value, int mask) {
        meeting.value[thread] = value;
        warp_barrier();
        const float other = meeting.value[thread ^ mask];
        warp_barrier();
        return other;
    };
    auto lowest_bit = [](unsigned bits) { return __builtin_ctz(bits); };
    auto copy = [](void* shared, const void* source) { *(float4*)shared = *(const float4*)source; };
    auto wait_for_copies = []() {};
    auto least = [](float a, float b) { return __builtin_fminf(a, b); };
    auto greatest = [](float a, float b) { return __builtin_fmaxf(a, b); };
    auto power_of_two = [](float t) { return exp2f(t); };
    auto reciprocal = [](float v) { return 1.0f / v; };
#endif
"""

COLLECTIVES = _THREAD + _WORDS
"""Barriers, votes and exchanges, and what else a GPU and a CPU spell differently."""
