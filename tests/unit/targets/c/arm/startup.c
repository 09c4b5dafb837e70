/* Start of a Cortex-M3/M4 in an emulator: vectors, memory, floating-point unit, then main and the semihosted exit. */
#include <stdint.h>

extern uint32_t data_image, data_start, data_end, bss_start, bss_end, stack_top;
extern void initialise_monitor_handles(void);
extern void __libc_init_array(void);
extern void exit(int);
extern int main(void);

void _init(void) {}
void _fini(void) {}

void reset(void)
{
    uint32_t *from = &data_image, *to;
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* coprocessors 10 and 11: full access */
    __asm volatile("dsb\nisb");
    for (to = &data_start; to < &data_end; to++) {
        *to = *from++;
    }
    for (to = &bss_start; to < &bss_end; to++) {
        *to = 0;
    }
    initialise_monitor_handles();
    __libc_init_array();
    exit(main());
}

static void stop(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void (*const vectors[8])(void) = {
    (void (*)(void))&stack_top, reset, stop, stop, stop, stop, stop, stop};
