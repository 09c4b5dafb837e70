/* SHA-256 by FIPS 180-4, in the words of its section 6.2. C99, no allocation, 0.4 kB of stack. */
#include "ect_identity.h"

static const uint32_t round_words[64] = { /* cube roots of the first 64 primes, 32 bits behind the point */
    0x428a2f98u, 0x71374491u, 0xb5c0fbcfu, 0xe9b5dba5u, 0x3956c25bu, 0x59f111f1u,
    0x923f82a4u, 0xab1c5ed5u, 0xd807aa98u, 0x12835b01u, 0x243185beu, 0x550c7dc3u,
    0x72be5d74u, 0x80deb1feu, 0x9bdc06a7u, 0xc19bf174u, 0xe49b69c1u, 0xefbe4786u,
    0x0fc19dc6u, 0x240ca1ccu, 0x2de92c6fu, 0x4a7484aau, 0x5cb0a9dcu, 0x76f988dau,
    0x983e5152u, 0xa831c66du, 0xb00327c8u, 0xbf597fc7u, 0xc6e00bf3u, 0xd5a79147u,
    0x06ca6351u, 0x14292967u, 0x27b70a85u, 0x2e1b2138u, 0x4d2c6dfcu, 0x53380d13u,
    0x650a7354u, 0x766a0abbu, 0x81c2c92eu, 0x92722c85u, 0xa2bfe8a1u, 0xa81a664bu,
    0xc24b8b70u, 0xc76c51a3u, 0xd192e819u, 0xd6990624u, 0xf40e3585u, 0x106aa070u,
    0x19a4c116u, 0x1e376c08u, 0x2748774cu, 0x34b0bcb5u, 0x391c0cb3u, 0x4ed8aa4au,
    0x5b9cca4fu, 0x682e6ff3u, 0x748f82eeu, 0x78a5636fu, 0x84c87814u, 0x8cc70208u,
    0x90befffau, 0xa4506cebu, 0xbef9a3f7u, 0xc67178f2u};

static uint32_t turned(uint32_t x, unsigned by) { return x >> by | x << (32u - by); }

static void block(uint32_t state[8], const uint8_t *p)
{
    uint32_t w[64], s[8];
    unsigned t;
    for (t = 0; t < 16u; t++) {
        w[t] = (uint32_t)p[4u * t] << 24 | (uint32_t)p[4u * t + 1u] << 16 | (uint32_t)p[4u * t + 2u] << 8 | p[4u * t + 3u];
    }
    for (t = 16u; t < 64u; t++) {
        uint32_t a = w[t - 15u], b = w[t - 2u];
        a = turned(a, 7) ^ turned(a, 18) ^ a >> 3;
        b = turned(b, 17) ^ turned(b, 19) ^ b >> 10;
        w[t] = w[t - 16u] + a + w[t - 7u] + b;
    }
    for (t = 0; t < 8u; t++) {
        s[t] = state[t];
    }
    for (t = 0; t < 64u; t++) {
        uint32_t one = s[7] + (turned(s[4], 6) ^ turned(s[4], 11) ^ turned(s[4], 25));
        uint32_t two = (turned(s[0], 2) ^ turned(s[0], 13) ^ turned(s[0], 22));
        unsigned k;
        one += ((s[4] & s[5]) ^ (~s[4] & s[6])) + round_words[t] + w[t];
        two += (s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]);
        for (k = 7u; k > 0; k--) {
            s[k] = s[k - 1u];
        }
        s[4] += one;
        s[0] = one + two;
    }
    for (t = 0; t < 8u; t++) {
        state[t] += s[t];
    }
}

void ect_identity(const void *data, size_t size, uint8_t identity[ECT_IDENTITY_SIZE])
{
    uint32_t state[8] = { /* square roots of the first eight primes */
    0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au,
    0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u};
    uint8_t last[128] = {0};
    const uint8_t *p = (const uint8_t *)data;
    uint64_t bits = (uint64_t)size * 8u;
    size_t left = size, end, k;
    for (; left >= 64u; left -= 64u, p += 64) {
        block(state, p);
    }
    for (k = 0; k < left; k++) {
        last[k] = p[k];
    }
    last[left] = 0x80u;
    end = left < 56u ? 64u : 128u;
    for (k = 0; k < 8u; k++) {
        last[end - 1u - k] = (uint8_t)(bits >> (8u * k));
    }
    for (k = 0; k < end; k += 64u) {
        block(state, last + k);
    }
    for (k = 0; k < ECT_IDENTITY_SIZE; k++) {
        identity[k] = (uint8_t)(state[k / 4u] >> (24u - 8u * (k % 4u)));
    }
}

int ect_is_identity(const void *data, size_t size, const uint8_t expected[ECT_IDENTITY_SIZE])
{
    uint8_t own[ECT_IDENTITY_SIZE];
    unsigned different = 0, k;
    ect_identity(data, size, own);
    for (k = 0; k < ECT_IDENTITY_SIZE; k++) {
        different |= (unsigned)(own[k] ^ expected[k]);
    }
    return different == 0;
}

ect_error ect_load_only(
    ect *e, const void *table, size_t size, void *work, size_t work_size, const uint8_t expected[ECT_IDENTITY_SIZE])
{
    if (!ect_is_identity(table, size, expected)) {
        (void)ect_load_any(e, table, 0, work, work_size); /* leaves e without a table */
        return ECT_FOREIGN;
    }
    return ect_load_any(e, table, size, work, work_size);
}
