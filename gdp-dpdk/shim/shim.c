#include "shim.h"

#include <stddef.h>

/* `Raw` in mbuf.rs reads and writes these fields where they are here. */
#define AT(field, offset) \
	_Static_assert(offsetof(struct rte_mbuf, field) == offset, #field " of rte_mbuf is not where mbuf.rs has it")
AT(buf_addr, 0);
AT(data_off, 16);
AT(refcnt, 18);
AT(nb_segs, 20);
AT(port, 22);
AT(ol_flags, 24);
AT(packet_type, 32);
AT(pkt_len, 36);
AT(data_len, 40);
AT(buf_len, 54);
AT(pool, 56);

int gdp_errno(void)
{
	return rte_errno;
}

uint16_t gdp_rx_burst(uint16_t port, uint16_t queue, struct rte_mbuf **mbufs, uint16_t count)
{
	return rte_eth_rx_burst(port, queue, mbufs, count);
}

uint16_t gdp_tx_burst(uint16_t port, uint16_t queue, struct rte_mbuf **mbufs, uint16_t count)
{
	return rte_eth_tx_burst(port, queue, mbufs, count);
}

int gdp_alloc(struct rte_mempool *pool, struct rte_mbuf **mbufs, unsigned int count)
{
	return rte_pktmbuf_alloc_bulk(pool, mbufs, count);
}

void gdp_free(struct rte_mbuf **mbufs, unsigned int count)
{
	rte_pktmbuf_free_bulk(mbufs, count);
}

struct rte_mbuf *gdp_refer(struct rte_mempool *pool, struct rte_mbuf *of)
{
	struct rte_mbuf *mbuf = rte_pktmbuf_alloc(pool);

	if (mbuf != NULL)
		rte_pktmbuf_attach(mbuf, of);
	return mbuf;
}

int gdp_chain(struct rte_mbuf *head, struct rte_mbuf *tail)
{
	return rte_pktmbuf_chain(head, tail);
}

struct rte_mbuf *gdp_next(struct rte_mbuf *mbuf)
{
	return mbuf->next;
}
