/* Memory of a page: taken once, before the first answer, and never given back. It is zero at first. */
#ifndef FREESTANDING_STDLIB
#define FREESTANDING_STDLIB
#include <stddef.h>

extern unsigned char __heap_base;
static size_t memory_end;

static inline void *malloc(size_t bytes) {
    if (!memory_end) memory_end = (size_t)&__heap_base;
    const size_t start = (memory_end + 15) / 16 * 16, end = start + bytes, page = 65536;
    const size_t there = __builtin_wasm_memory_size(0), needed = (end + page - 1) / page;
    if (end < start || (needed > there && __builtin_wasm_memory_grow(0, needed - there) == (size_t)-1)) return NULL;
    memory_end = end;
    return (void *)start;
}
static inline void *calloc(size_t count, size_t size) { return malloc(count * size); }
static inline void free(void *start) { (void)start; }
#endif
