/* Only what cfid's app uses of the firmware's header of this name. */
#ifndef CRTP_H
#define CRTP_H
#include <stdint.h>
#define CRTP_MAX_DATA_SIZE 30
#define CRTP_HEADER(port, channel) (uint8_t)((((port) & 0x0F) << 4) | ((channel) & 0x0F))
typedef struct {
    uint8_t size;
    union {
        uint8_t header;
        struct {
            uint8_t channel : 2;
            uint8_t reserved : 2;
            uint8_t port : 4;
        };
    };
    uint8_t data[CRTP_MAX_DATA_SIZE];
} CRTPPacket;
typedef void (*CrtpCallback)(CRTPPacket *);
void crtpRegisterPortCB(int port, CrtpCallback callback);
int crtpSendPacket(CRTPPacket *packet);
int crtpSendPacketBlock(CRTPPacket *packet);
#endif
