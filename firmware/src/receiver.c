#include "receiver.h"

#include "cobs.h"
#include "crc16.h"

static bool parse(uint8_t *frame, uint8_t count, struct request *request)
{
    if (cobs_decode(frame, count) != HEADER_SIZE + CRC_SIZE) {
        return false;
    }
    const uint16_t crc = (uint16_t)(frame[HEADER_SIZE] | frame[HEADER_SIZE + 1] << 8);
    if (crc != crc16(frame, HEADER_SIZE) || frame[0] != FORMAT_VERSION) {
        return false;
    }
    if (frame[1] != KIND_PING && frame[1] != KIND_IDENTIFY) {
        return false;
    }
    request->kind = (enum kind)frame[1];
    request->sequence = (uint32_t)frame[4] | (uint32_t)frame[5] << 8 | (uint32_t)frame[6] << 16 | (uint32_t)frame[7] << 24;
    return true;
}

bool receiver_take(struct receiver *receiver, uint8_t byte, struct request *request)
{
    if (byte == 0) {
        const uint8_t count = receiver->count;
        receiver->count = 0;
        return count <= REQUEST_FRAME && parse(receiver->frame, count, request);
    }
    if (receiver->count < REQUEST_FRAME) {
        receiver->frame[receiver->count++] = byte;
    } else {
        receiver->count = REQUEST_FRAME + 1;
    }
    return false;
}
