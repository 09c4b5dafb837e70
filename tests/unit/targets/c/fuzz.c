/* libFuzzer harness: clang -g -O1 -fsanitize=fuzzer,address,undefined -Ierrpipe/tables/runtime errpipe/tables/runtime/ect.c
 * tests/unit/targets/c/fuzz.c. The checksum and the size are mended first, so that damage gets past them. Without libFuzzer,
 * -DALONE makes a program: alone FILE... COUNT mutates each table COUNT times (see driver.c). */
#include <stdio.h>
#include <stdlib.h>

#include "driver.c"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    uint8_t *copy = malloc(size ? size : 1);
    memcpy(copy, data, size);
    if (size >= 24) {
        uint32_t crc, total = (uint32_t)size;
        memcpy(copy + 16, &total, 4);
        crc = crc_of(copy + 24, size - 24);
        memcpy(copy + 20, &crc, 4);
    }
    run_some(copy, size);
    run_some(data, size);
    free(copy);
    return 0;
}

#ifdef ALONE
int main(int argc, char **argv)
{
    size_t accepted = 0, count = (size_t)atol(argv[argc - 1]);
    int i;
    for (i = 1; i < argc - 1; i++) {
        static uint8_t table[1 << 20];
        FILE *file = fopen(argv[i], "rb");
        size_t size = file == NULL ? 0 : fread(table, 1, sizeof table, file);
        if (size == 0) {
            return 2;
        }
        fclose(file);
        accepted += mutate(table, size, count, (uint64_t)i);
    }
    printf("%lu executions, %lu accepted\n", (unsigned long)(count * (size_t)(argc - 2)), (unsigned long)accepted);
    return 0;
}
#endif
