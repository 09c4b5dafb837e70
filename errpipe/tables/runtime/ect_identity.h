/* The identity of a table: SHA-256 of its bytes (FIPS 180-4), as `sha256sum table.ect` prints it and a registry names it.
 *
 * A loader that is told which identity it may run refuses all others: a mix-up, and a forger who can change the table but
 * not the expected identity. It checks no signature: whoever brings the table and its identity to the controller does that
 * (`minisign -V -p errpipe.pub -m table.ect`). */
#ifndef ECT_IDENTITY_H
#define ECT_IDENTITY_H

#include "ect.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ECT_IDENTITY_SIZE 32

/* The identity of `size` bytes at `data`. */
void ect_identity(const void *data, size_t size, uint8_t identity[ECT_IDENTITY_SIZE]);

/* ect_load_any of the table with the expected identity: any other is ECT_FOREIGN and is not used, as after any error. */
ect_error ect_load_only(
    ect *e, const void *table, size_t size, void *work, size_t work_size, const uint8_t expected[ECT_IDENTITY_SIZE]);

/* 1 where the bytes have the expected identity, else 0. */
int ect_is_identity(const void *data, size_t size, const uint8_t expected[ECT_IDENTITY_SIZE]);

#ifdef __cplusplus
}
#endif
#endif
