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

/* As rte_pktmbuf_pool_create, but without gaps. In ordinary memory that one puts no mbuf across the end of a page, where net_af_xdp
 * takes all to lie one behind the other: it would lose every packet in an mbuf that lies behind where that should end. Only devices that
 * read memory by themselves need whole pages, and these need huge ones. */
struct rte_mempool *gdp_pool_create(const char *name, unsigned int count, unsigned int cache, uint16_t room)
{
	struct rte_pktmbuf_pool_private private = { .mbuf_data_room_size = room };
	unsigned int flags = rte_eal_has_hugepages() ? 0 : RTE_MEMPOOL_F_NO_IOVA_CONTIG;
	struct rte_mempool *pool = rte_mempool_create_empty(name, count, sizeof(struct rte_mbuf) + room, cache,
							    sizeof(private), SOCKET_ID_ANY, flags);
	int result;

	if (pool == NULL)
		return NULL;
	result = rte_mempool_set_ops_byname(pool, rte_mbuf_best_mempool_ops(), NULL);
	if (result == 0) {
		rte_pktmbuf_pool_init(pool, &private);
		result = rte_mempool_populate_default(pool);
	}
	if (result < 0) {
		rte_mempool_free(pool);
		rte_errno = -result;
		return NULL;
	}
	rte_mempool_obj_iter(pool, rte_pktmbuf_init, NULL);
	return pool;
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
