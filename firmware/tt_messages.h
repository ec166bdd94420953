/* Constants and layouts of the wire protocol's packets, docs/protocol.md.
 *
 * Made from docs/protocol.yaml by `make protocol`; changes belong there.
 * TT_V2_ROW_COUNT is the offset of the field `count` in a ROW of version 2, counted from the
 * type byte; TT_V2_ROW_SIZE are its bytes in front of the first field of variable size.
 */
#ifndef TT_MESSAGES_H
#define TT_MESSAGES_H

#define TT_MAX_PACKET 4096u /* longest packet before COBS, with its CRC-32, bytes */
#define TT_CRC_SIZE 4u /* bytes of the CRC-32 behind the last field */
#define TT_NO_READING 0xFFFFu /* a reading that is none (0x0000 on the line) */
#define TT_HIGHEST_READING 0xFFFEu /* largest reading */
#define TT_NO_ADDRESS 0u /* a device that has its line to itself; a packet for it */
#define TT_ALL_ADDRESSES 255u /* a command that all obey and none answers */
#define TT_OWN_ORDER 0u /* scan: the device's own order, each electrode in turn */

/* Types of packets */
#define TT_IDENTIFY 0x01u
#define TT_START 0x02u
#define TT_STOP 0x03u
#define TT_SET_RATE 0x04u
#define TT_SET_SCAN 0x05u
#define TT_KEEP_ALIVE 0x06u
#define TT_ROW 0x10u
#define TT_IDENTITY 0x11u
#define TT_ACK 0x12u
#define TT_ERROR 0x13u
#define TT_STATUS 0x14u

/* Codes of ERROR */
#define TT_UNKNOWN_COMMAND 1u
#define TT_BAD_VALUE 2u
#define TT_UNSUPPORTED_VERSION 3u
#define TT_HARDWARE_FAULT 4u

/* IDENTIFY, version 1 */
#define TT_V1_IDENTIFY_TYPE 0u /* u8 */
#define TT_V1_IDENTIFY_VERSION 1u /* u8 */
#define TT_V1_IDENTIFY_TAG 2u /* u16 */
#define TT_V1_IDENTIFY_SIZE 4u

/* IDENTIFY, version 2 */
#define TT_V2_IDENTIFY_TYPE 0u /* u8 */
#define TT_V2_IDENTIFY_VERSION 1u /* u8 */
#define TT_V2_IDENTIFY_TAG 2u /* u16 */
#define TT_V2_IDENTIFY_ADDRESS 6u /* u8 */
#define TT_V2_IDENTIFY_SIZE 8u

/* START, version 1 */
#define TT_V1_START_TYPE 0u /* u8 */
#define TT_V1_START_VERSION 1u /* u8 */
#define TT_V1_START_TAG 2u /* u16 */
#define TT_V1_START_SIZE 4u

/* START, version 2 */
#define TT_V2_START_TYPE 0u /* u8 */
#define TT_V2_START_VERSION 1u /* u8 */
#define TT_V2_START_TAG 2u /* u16 */
#define TT_V2_START_TIMEOUT 4u /* u16 */
#define TT_V2_START_ADDRESS 6u /* u8 */
#define TT_V2_START_FRAMES 8u /* u32 */
#define TT_V2_START_SIZE 12u

/* STOP, version 1 */
#define TT_V1_STOP_TYPE 0u /* u8 */
#define TT_V1_STOP_VERSION 1u /* u8 */
#define TT_V1_STOP_TAG 2u /* u16 */
#define TT_V1_STOP_SIZE 4u

/* STOP, version 2 */
#define TT_V2_STOP_TYPE 0u /* u8 */
#define TT_V2_STOP_VERSION 1u /* u8 */
#define TT_V2_STOP_TAG 2u /* u16 */
#define TT_V2_STOP_ADDRESS 6u /* u8 */
#define TT_V2_STOP_SIZE 8u

/* SET_RATE, version 1 */
#define TT_V1_SET_RATE_TYPE 0u /* u8 */
#define TT_V1_SET_RATE_VERSION 1u /* u8 */
#define TT_V1_SET_RATE_TAG 2u /* u16 */
#define TT_V1_SET_RATE_RATE 4u /* f32 */
#define TT_V1_SET_RATE_SIZE 8u

/* SET_RATE, version 2 */
#define TT_V2_SET_RATE_TYPE 0u /* u8 */
#define TT_V2_SET_RATE_VERSION 1u /* u8 */
#define TT_V2_SET_RATE_TAG 2u /* u16 */
#define TT_V2_SET_RATE_ADDRESS 6u /* u8 */
#define TT_V2_SET_RATE_RATE 8u /* f32 */
#define TT_V2_SET_RATE_SIZE 12u

/* SET_SCAN, version 2 */
#define TT_V2_SET_SCAN_TYPE 0u /* u8 */
#define TT_V2_SET_SCAN_VERSION 1u /* u8 */
#define TT_V2_SET_SCAN_TAG 2u /* u16 */
#define TT_V2_SET_SCAN_COUNT 4u /* u16 */
#define TT_V2_SET_SCAN_ADDRESS 6u /* u8 */
#define TT_V2_SET_SCAN_ORDER 8u /* u16[count] */
#define TT_V2_SET_SCAN_SIZE 8u

/* KEEP_ALIVE, version 2 */
#define TT_V2_KEEP_ALIVE_TYPE 0u /* u8 */
#define TT_V2_KEEP_ALIVE_VERSION 1u /* u8 */
#define TT_V2_KEEP_ALIVE_TAG 2u /* u16 */
#define TT_V2_KEEP_ALIVE_ADDRESS 6u /* u8 */
#define TT_V2_KEEP_ALIVE_SIZE 8u

/* ROW, version 1 */
#define TT_V1_ROW_TYPE 0u /* u8 */
#define TT_V1_ROW_VERSION 1u /* u8 */
#define TT_V1_ROW_COUNT 2u /* u16 */
#define TT_V1_ROW_ROW 4u /* u16 */
#define TT_V1_ROW_ROWS 6u /* u16 */
#define TT_V1_ROW_SEQUENCE 8u /* u32 */
#define TT_V1_ROW_ROW_END 12u /* u32 */
#define TT_V1_ROW_FRAME_TIME 16u /* u64 */
#define TT_V1_ROW_SCALE 24u /* f32 */
#define TT_V1_ROW_DRIVE_VOLTAGE 28u /* f32 */
#define TT_V1_ROW_GROUNDED 32u /* u16 */
#define TT_V1_ROW_READINGS 34u /* u16[count] */
#define TT_V1_ROW_SIZE 34u

/* ROW, version 2 */
#define TT_V2_ROW_TYPE 0u /* u8 */
#define TT_V2_ROW_VERSION 1u /* u8 */
#define TT_V2_ROW_SCAN 2u /* u16 */
#define TT_V2_ROW_ROW 4u /* u16 */
#define TT_V2_ROW_ADDRESS 6u /* u8 */
#define TT_V2_ROW_SEQUENCE 8u /* u32 */
#define TT_V2_ROW_ROW_END 12u /* u32 */
#define TT_V2_ROW_FRAME_TIME 16u /* u64 */
#define TT_V2_ROW_SCALE 24u /* f32 */
#define TT_V2_ROW_DRIVE_VOLTAGE 28u /* f32 */
#define TT_V2_ROW_COUNT 32u /* u16 */
#define TT_V2_ROW_ROWS 34u /* u16 */
#define TT_V2_ROW_GROUNDED 36u /* u16 */
#define TT_V2_ROW_ZERO 38u /* u16 */
#define TT_V2_ROW_READINGS 40u /* u16[count] */
#define TT_V2_ROW_SIZE 40u

/* IDENTITY, version 1 */
#define TT_V1_IDENTITY_TYPE 0u /* u8 */
#define TT_V1_IDENTITY_VERSION 1u /* u8 */
#define TT_V1_IDENTITY_TAG 2u /* u16 */
#define TT_V1_IDENTITY_ELECTRODES 4u /* u16 */
#define TT_V1_IDENTITY_ROWS 6u /* u16 */
#define TT_V1_IDENTITY_ADC_BITS 8u /* u8 */
#define TT_V1_IDENTITY_RANGE 10u /* f32 */
#define TT_V1_IDENTITY_RATE 14u /* f32 */
#define TT_V1_IDENTITY_LINE_RATE 18u /* u32 */
#define TT_V1_IDENTITY_MAX_RATE 22u /* f32 */
#define TT_V1_IDENTITY_NAME 26u /* string */
#define TT_V1_IDENTITY_SIZE 26u

/* IDENTITY, version 2 */
#define TT_V2_IDENTITY_TYPE 0u /* u8 */
#define TT_V2_IDENTITY_VERSION 1u /* u8 */
#define TT_V2_IDENTITY_TAG 2u /* u16 */
#define TT_V2_IDENTITY_ELECTRODES 4u /* u16 */
#define TT_V2_IDENTITY_ADDRESS 6u /* u8 */
#define TT_V2_IDENTITY_ADC_BITS 7u /* u8 */
#define TT_V2_IDENTITY_ROWS 8u /* u16 */
#define TT_V2_IDENTITY_MAX_SCAN 10u /* u16 */
#define TT_V2_IDENTITY_BOOT 12u /* u32 */
#define TT_V2_IDENTITY_LOWEST 16u /* f32 */
#define TT_V2_IDENTITY_RANGE 20u /* f32 */
#define TT_V2_IDENTITY_RATE 24u /* f32 */
#define TT_V2_IDENTITY_MAX_ROW_RATE 28u /* f32 */
#define TT_V2_IDENTITY_LINE_RATE 32u /* u32 */
#define TT_V2_IDENTITY_NAME 36u /* string */
#define TT_V2_IDENTITY_SIZE 36u

/* ACK, version 1 */
#define TT_V1_ACK_TYPE 0u /* u8 */
#define TT_V1_ACK_VERSION 1u /* u8 */
#define TT_V1_ACK_TAG 2u /* u16 */
#define TT_V1_ACK_COMMAND 4u /* u8 */
#define TT_V1_ACK_STREAMING 5u /* u8 */
#define TT_V1_ACK_RATE 6u /* f32 */
#define TT_V1_ACK_SIZE 10u

/* ACK, version 2 */
#define TT_V2_ACK_TYPE 0u /* u8 */
#define TT_V2_ACK_VERSION 1u /* u8 */
#define TT_V2_ACK_TAG 2u /* u16 */
#define TT_V2_ACK_COMMAND 4u /* u8 */
#define TT_V2_ACK_STREAMING 5u /* u8 */
#define TT_V2_ACK_ADDRESS 6u /* u8 */
#define TT_V2_ACK_RATE 8u /* f32 */
#define TT_V2_ACK_SEQUENCE 12u /* u32 */
#define TT_V2_ACK_ROWS 16u /* u16 */
#define TT_V2_ACK_SIZE 18u

/* ERROR, version 1 */
#define TT_V1_ERROR_TYPE 0u /* u8 */
#define TT_V1_ERROR_VERSION 1u /* u8 */
#define TT_V1_ERROR_TAG 2u /* u16 */
#define TT_V1_ERROR_COMMAND 4u /* u8 */
#define TT_V1_ERROR_CODE 5u /* u8 */
#define TT_V1_ERROR_MESSAGE 6u /* text */
#define TT_V1_ERROR_SIZE 6u

/* ERROR, version 2 */
#define TT_V2_ERROR_TYPE 0u /* u8 */
#define TT_V2_ERROR_VERSION 1u /* u8 */
#define TT_V2_ERROR_TAG 2u /* u16 */
#define TT_V2_ERROR_COMMAND 4u /* u8 */
#define TT_V2_ERROR_CODE 5u /* u8 */
#define TT_V2_ERROR_ADDRESS 6u /* u8 */
#define TT_V2_ERROR_MESSAGE 8u /* text */
#define TT_V2_ERROR_SIZE 8u

/* STATUS, version 2 */
#define TT_V2_STATUS_TYPE 0u /* u8 */
#define TT_V2_STATUS_VERSION 1u /* u8 */
#define TT_V2_STATUS_TAG 2u /* u16 */
#define TT_V2_STATUS_STREAMING 4u /* u8 */
#define TT_V2_STATUS_ADDRESS 6u /* u8 */
#define TT_V2_STATUS_BOOT 8u /* u32 */
#define TT_V2_STATUS_TEMPERATURE 12u /* f32 */
#define TT_V2_STATUS_TIME 16u /* u64 */
#define TT_V2_STATUS_DROPPED 24u /* u32 */
#define TT_V2_STATUS_SEQUENCE 28u /* u32 */
#define TT_V2_STATUS_SIZE 32u

#endif
